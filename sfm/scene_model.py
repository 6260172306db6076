"""What the steps of the reconstruction hand on: correspondences, and the model of a static scene."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import PixelFrame, ViewPair, inverse_depth_range, oriented

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Points of the first key frame and where they are in the second.

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
        """Those of which both points are known, shape (N,)."""
        return np.asarray(np.isfinite(self.first).all(axis=1) & np.isfinite(self.second).all(axis=1))

    def __getitem__(self, chosen: Mask | NDArray[np.int64]) -> Self:
        """Return some of the correspondences, chosen by mask or by index."""
        return type(self)(self.first[chosen], self.second[chosen], self.error[chosen])

    @classmethod
    def concatenate(cls, parts: "list[Correspondences]") -> Self:
        """Join lists of correspondences.

        Parameters
        ----------
        parts : list of Correspondences
            At least one.

        Returns
        -------
        Correspondences
            All of them, in order.
        """
        return cls(
            np.concatenate([part.first for part in parts]),
            np.concatenate([part.second for part in parts]),
            np.concatenate([part.error for part in parts]),
        )

    @classmethod
    def empty(cls) -> Self:
        """Return no correspondences at all."""
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
        """The two views, and the range of depth that the points before them tell."""
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
    kept : ndarray of shape (N,), bool
        Correspondences that passed all tests.
    reason : str
        Why there is no camera; empty if there is one.
    """

    camera: Floats
    fundamental: Floats
    kept: Mask
    reason: str = ""

    @classmethod
    def missing(cls, num_points: int, reason: str) -> Self:
        """Say why there is no camera.

        Parameters
        ----------
        num_points : int
            Correspondences that were given.
        reason : str
            One line.

        Returns
        -------
        CameraPair
            Without any of them.
        """
        return cls(np.eye(3, 4), np.zeros((3, 3)), np.zeros(num_points, dtype=bool), reason)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """What came of an attempt to reconstruct a scene from two key frames.

    Attributes
    ----------
    model : Model or None
        The scene; None where there is none to be had.
    reason : str
        Why the model is missing or cannot be trusted; empty if it can.
    motion : str
        What the camera did: ``general``, ``rotation`` (or a distant or planar scene), ``none``, ``unknown``.
    stages : dict of str to Correspondences
        Correspondences after each step of the pipeline, by its name, for figures and studies.
    """

    model: Model | None
    reason: str
    motion: str
    stages: dict[str, Correspondences] = field(default_factory=dict)

    @property
    def success(self) -> bool:
        """Whether there is a model that can be trusted."""
        return self.model is not None and not self.reason
