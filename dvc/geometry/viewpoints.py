"""Viewpoints: positions on the lattice of a rectified array, or calibrated cameras.

Two viewpoints of one kind have a warp (`dvc.geometry.warping`), for which the inverse depth of a
pixel is its disparity in an array, and 1/z of the source between calibrated cameras.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from dvc.arrays import Floats
from dvc.geometry.camera_array import LatticePosition


@dataclass(frozen=True, eq=False)
class CalibratedViewpoint:
    """A calibrated camera without lens distortion."""

    intrinsic: Floats  # K, upper triangular, in pixels, the centre of the first pixel at (0, 0)
    pose: Floats  # [R | t], from the world to the camera

    @property
    def centre(self) -> Floats:
        """Position in the world, shape (3,)."""
        return -self.pose[:, :3].T @ self.pose[:, 3]


Viewpoint = LatticePosition | CalibratedViewpoint


def warp_between(source: Viewpoint, target: Viewpoint) -> Floats:
    """Return the warp from one view to another."""
    if isinstance(source, LatticePosition) and isinstance(target, LatticePosition):
        return lattice_warp(source, target)
    if isinstance(source, CalibratedViewpoint) and isinstance(target, CalibratedViewpoint):
        return calibrated_warp(source, target)
    raise ValueError("`source` and `target` must be of one kind")


def lattice_warp(source: LatticePosition, target: LatticePosition) -> Floats:
    """Return the warp between two rectified views, for which disparity is inverse depth."""
    m, n = target.m - source.m, target.n - source.n
    return np.array([[1.0, 0.0, 0.0, -m], [0.0, 1.0, 0.0, -n], [0.0, 0.0, 1.0, 0.0]])


def calibrated_warp(source: CalibratedViewpoint, target: CalibratedViewpoint) -> Floats:
    """Return the warp between two calibrated views; inverse depth is 1/z of the source."""
    rotation = target.pose[:, :3] @ source.pose[:, :3].T
    translation = target.pose[:, 3] - rotation @ source.pose[:, 3]
    turned = target.intrinsic @ rotation @ np.linalg.inv(source.intrinsic)
    return np.ascontiguousarray(np.column_stack([turned, target.intrinsic @ translation]))


def distance(first: Viewpoint, second: Viewpoint) -> float:
    """Return the distance of two viewpoints."""
    if isinstance(first, LatticePosition) and isinstance(second, LatticePosition):
        return math.hypot(first.m - second.m, first.n - second.n)
    assert isinstance(first, CalibratedViewpoint)
    assert isinstance(second, CalibratedViewpoint)
    return float(np.linalg.norm(first.centre - second.centre))


def between(first: Viewpoint, second: Viewpoint, share: float) -> Viewpoint:
    """Return a viewpoint on the way from one to another."""
    if isinstance(first, LatticePosition) and isinstance(second, LatticePosition):
        return LatticePosition(*(a + share * (b - a) for a, b in zip(first, second, strict=True)))
    assert isinstance(first, CalibratedViewpoint)
    assert isinstance(second, CalibratedViewpoint)
    turn, _ = cv2.Rodrigues(second.pose[:, :3] @ first.pose[:, :3].T)
    rotation = cv2.Rodrigues(share * turn)[0] @ first.pose[:, :3]
    centre = first.centre + share * (second.centre - first.centre)
    intrinsic = first.intrinsic + share * (second.intrinsic - first.intrinsic)
    return CalibratedViewpoint(intrinsic, np.column_stack([rotation, -rotation @ centre]))
