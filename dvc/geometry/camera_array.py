"""Planar camera arrays in their rectified space: views on a lattice, disparities to try, and surfaces.

Convention (2.5): a point at (x, y) with disparity d in the frame of camera (0, 0) is seen by camera (m, n) at
``(x - m d, y - n d)``. Disparities are in pixels per unit of m and n; larger ones are nearer.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Bytes, Floats, Integers, Mask, Singles


class LatticePosition(NamedTuple):
    """Position of a camera in the plane of an array."""

    m: float  # to the right and downwards; whole numbers on a regular lattice
    n: float


class DisparityLabels(NamedTuple):
    """Disparities to try: ``lowest + k * step`` for k from 0 to ``num_labels - 1``."""

    lowest: float  # first disparity, in pixels per unit of m and n, and distance to the next
    step: float
    num_labels: int  # at least 1

    @property
    def highest(self) -> float:
        """The last disparity, that of the nearest surface."""
        return self.lowest + self.step * (self.num_labels - 1)

    def disparity(self, label: Floats) -> Floats:
        """Return the disparities of labels."""
        return self.lowest + self.step * label

    def label(self, disparity: NDArray[np.floating]) -> Integers:
        """Return the nearest label of each disparity."""
        nearest = np.floor((disparity.astype(np.float64) - self.lowest) / self.step + 0.5)
        return np.asarray(np.clip(nearest, 0, self.num_labels - 1), np.int64)


@dataclass(frozen=True, eq=False)
class ArrayView:
    """A rectified picture of a camera array."""

    name: str  # stem of its file, unique in the array
    image: Bytes  # red, green and blue; grey pictures have three equal channels
    position: LatticePosition  # of its camera
    valid: Mask | None = None  # pixels with content after a rectification; None: all

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.image.shape[0], self.image.shape[1]

    @property
    def seen(self) -> Mask:
        """Mask of pixels with content: `valid`, or all."""
        return np.ones(self.shape, np.bool_) if self.valid is None else self.valid


@dataclass(frozen=True, eq=False)
class CameraArray:
    """Rectified views of one size at distinct positions."""

    views: tuple[ArrayView, ...]  # at least one

    def __getitem__(self, index: int) -> ArrayView:
        return self.views[index]

    def __len__(self) -> int:
        return len(self.views)

    def __iter__(self) -> Iterator[ArrayView]:
        return iter(self.views)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of every view."""
        return self.views[0].shape

    @property
    def reference(self) -> int:
        """Index of the view nearest to (0, 0), or of the first of several."""
        distance = [view.position.m**2 + view.position.n**2 for view in self.views]
        return distance.index(min(distance))


@dataclass(frozen=True, eq=False)
class Surface:
    """Surface seen by one camera.

    Attributes
    ----------
    disparity : ndarray of shape (H, W), float32
        Disparity of every pixel, in pixels per unit of m.
    occluded : ndarray of shape (H, W), bool
        Mask of pixels that no other camera sees; their disparity is that of the background around them.
    confidence : ndarray of shape (H, W), float32
        Probability that the disparity is right within a pixel of parallax between neighbours.
    """

    disparity: Singles
    occluded: Mask
    confidence: Singles


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Surfaces of all cameras of an array.

    Attributes
    ----------
    array : CameraArray
        The views.
    labels : DisparityLabels
        Tried disparities.
    surfaces : tuple of Surface
        One for each view.
    figures : dict
        Report of the reconstruction: iterations, changes, seconds; JSON-safe.
    """

    array: CameraArray
    labels: DisparityLabels
    surfaces: tuple[Surface, ...]
    figures: dict[str, Any] = field(default_factory=dict)
