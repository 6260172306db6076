"""Surfaces of the cameras of an array: what a reconstruction gives, and layers and sprites are made of."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.camera_array import CameraArray, DisparityLabels


@dataclass(frozen=True, eq=False)
class Surface:
    """What one camera sees.

    Attributes
    ----------
    disparity : ndarray of shape (H, W), float32
        In pixels per unit of m, of every pixel.
    occluded : ndarray of shape (H, W), bool
        Seen by no other camera: the disparity is that of what lies around and behind.
    confidence : ndarray of shape (H, W), float32
        Probability that the disparity is right within a pixel of parallax between neighbours.
    """

    disparity: NDArray[np.float32]
    occluded: NDArray[np.bool_]
    confidence: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Surfaces of all cameras of an array.

    Attributes
    ----------
    array : CameraArray
        The views.
    labels : DisparityLabels
        Disparities that were tried.
    surfaces : tuple of Surface
        One for each view.
    figures : dict
        What is reported beside them: iterations, changes, seconds; JSON-safe.
    """

    array: CameraArray
    labels: DisparityLabels
    surfaces: tuple[Surface, ...]
    figures: dict[str, Any] = field(default_factory=dict)
