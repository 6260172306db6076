"""Data that steps of the reconstruction pass on: correspondences, cameras, and the model of a scene."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from dvc.arrays import Floats, Integers, Mask
from dvc.geometry.cameras import PixelFrame, ViewPair, inverse_depth_range, oriented


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Points of the first key frame and their positions in the second.

    Attributes
    ----------
    first, second : ndarray of shape (N, 2), float64
        Image points (x, y) in pixels.
    error : ndarray of shape (N,), float64
        Mean squared error between the neighbourhoods of the two points, in squared luma levels.
    """

    first: Floats
    second: Floats
    error: Floats

    def __len__(self) -> int:
        """Return the number of correspondences."""
        return len(self.first)

    @property
    def motion(self) -> Floats:
        """Displacement from the first to the second key frame, shape (N, 2), in pixels."""
        return self.second - self.first

    @property
    def finite(self) -> Mask:
        """Mask of correspondences with two finite points, shape (N,)."""
        return np.asarray(np.isfinite(self.first).all(axis=1) & np.isfinite(self.second).all(axis=1))

    def __getitem__(self, chosen: Mask | Integers) -> Self:
        """Return some of the correspondences, chosen by mask or by index."""
        return type(self)(self.first[chosen], self.second[chosen], self.error[chosen])

    @classmethod
    def concatenate(cls, parts: "list[Correspondences]") -> Self:
        """Join at least one list of correspondences."""
        return cls(
            np.concatenate([part.first for part in parts]),
            np.concatenate([part.second for part in parts]),
            np.concatenate([part.error for part in parts]),
        )

    @classmethod
    def empty(cls) -> Self:
        """Return an empty list of correspondences."""
        return cls(np.empty((0, 2)), np.empty((0, 2)), np.empty(0))


@dataclass(frozen=True, eq=False)
class Model:
    """Two cameras and a cloud of points, in a projective frame that is nearly Euclidean.

    A point of the first key frame at normalised coordinates ``x`` (homogeneous, third entry 1) with
    projective depth ``depth`` is the 3D point ``X = (depth * x, 1)``; the first camera is ``[I | 0]``.

    Attributes
    ----------
    pixel_frame : PixelFrame
        Size of the images, and their normalised coordinates.
    fundamental : ndarray of shape (3, 3), float64
        F with ``x1' F x0 = 0`` in pixels, (5.1); unit Frobenius norm.
    second_camera : ndarray of shape (3, 4), float64
        Projection matrix of the second key frame in normalised coordinates, Frobenius norm sqrt(3).
    correspondences : Correspondences
        Reliable points, in pixels.
    depths : ndarray of shape (N,), float64
        Projective depth of each in the first camera.
    """

    pixel_frame: PixelFrame
    fundamental: Floats
    second_camera: Floats
    correspondences: Correspondences
    depths: Floats

    @property
    def first_camera(self) -> Floats:
        """Projection matrix of the first key frame in normalised coordinates, ``[I | 0]``, shape (3, 4)."""
        return np.eye(3, 4)

    @property
    def points(self) -> Floats:
        """Homogeneous 3D points, shape (N, 4)."""
        normalized = self.pixel_frame.to_normalized(self.correspondences.first)
        return np.column_stack([self.depths[:, None] * normalized, self.depths, np.ones(len(self.depths))])

    @property
    def view_pair(self) -> ViewPair:
        """The two views, with the range of depth of the points in front of each."""
        usable = np.isfinite(self.depths) & (self.depths > 0)
        in_second = self.points[usable] @ oriented(self.second_camera)[2]
        ranges = (
            inverse_depth_range(1.0 / self.depths[usable]),
            inverse_depth_range(1.0 / in_second[in_second > 0]),
        )
        return ViewPair(self.pixel_frame, (self.first_camera, self.second_camera), ranges)


@dataclass(frozen=True, eq=False)
class CameraPair:
    """The second camera, and the points that agree with it.

    Attributes
    ----------
    camera : ndarray of shape (3, 4), float64
        Second camera in normalised coordinates, Frobenius norm sqrt(3); the first is ``[I | 0]``.
    fundamental : ndarray of shape (3, 3), float64
        F in pixels, unit norm.
    inliers : ndarray of shape (N,), bool
        Correspondences that passed all tests.
    reason : str
        Reason for a missing camera; empty on success.
    """

    camera: Floats
    fundamental: Floats
    inliers: Mask
    reason: str = ""

    @classmethod
    def missing(cls, num_points: int, reason: str) -> Self:
        """Return a failure, without inliers."""
        return cls(np.eye(3, 4), np.zeros((3, 3)), np.zeros(num_points, dtype=bool), reason)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Result of the reconstruction of a scene from two key frames.

    Attributes
    ----------
    model : Model or None
        The scene; None if the reconstruction failed.
    reason : str
        Reason why the model is missing or cannot be trusted; empty if it can.
    motion : str
        Motion of the camera: ``general``, ``rotation`` (or a distant or planar scene), ``none``, ``unknown``.
    stages : dict of str to Correspondences
        Correspondences after each step of the pipeline, by its name, for figures and studies.
    """

    model: Model | None
    reason: str
    motion: str
    stages: dict[str, Correspondences] = field(default_factory=dict)

    @property
    def success(self) -> bool:
        """Whether the model can be trusted."""
        return self.model is not None and not self.reason
