"""Cameras of several frames, points of the scene, and where frames see them; triangulation of the points."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sfm.mapping.tracking import SeenPoints

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

MIN_ANGLE_DEG = 1.5
"""Least angle between the rays to a point; below it the depth is noise."""
MAX_ERROR_PX = 2.0
"""Reprojection error beyond which a point is not where its track is."""
NUM_STEPS = 4
"""Gauss-Newton steps after the linear solution."""
MIN_DEPTH = 1e-9


@dataclass(frozen=True, eq=False)
class Observations:
    """Where frames see points, one line for each."""

    frames: Indices  # numbers of frames
    points: Indices  # numbers of points
    positions: Floats  # (x, y) in pixels

    def __getitem__(self, chosen: Mask | Indices) -> "Observations":
        """Return some of the lines."""
        return Observations(self.frames[chosen], self.points[chosen], self.positions[chosen])

    def joined(self, other: "Observations") -> "Observations":
        """Return these lines and others."""
        return Observations(
            np.concatenate([self.frames, other.frames]),
            np.concatenate([self.points, other.points]),
            np.concatenate([self.positions, other.positions]),
        )


@dataclass(eq=False)
class Structure:
    """A part of the scene in the making."""

    K: Floats  # intrinsics of all frames
    poses: dict[int, Floats] = field(default_factory=dict)  # (3, 4) by number of frame
    points: Floats = field(default_factory=lambda: np.empty((0, 3)))  # nan where a point is not known

    @property
    def known(self) -> Mask:
        """Which points are known."""
        known: Mask = np.isfinite(self.points[:, 0])
        return known


def observations(seen: Sequence[SeenPoints], frames: Sequence[int]) -> Observations:
    """Put together what some frames see."""
    parts = [seen[index] for index in frames]
    numbers = np.repeat(np.asarray(frames, np.int64), [len(part.ids) for part in parts])
    ids = np.concatenate([np.empty(0, np.int64), *(part.ids for part in parts)])
    return Observations(numbers, ids, np.concatenate([np.empty((0, 2)), *(part.positions for part in parts)]))


def reprojection(structure: Structure, seen: Observations) -> tuple[Floats, Floats]:
    """Return errors in pixels, inf where unknown, and depths of points in the frames that see them."""
    poses = stacked(structure.poses, seen.frames)
    inside = np.einsum("nij,nj->ni", poses[:, :, :3], structure.points[seen.points]) + poses[:, :, 3]
    depth = inside[:, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        image = inside @ structure.K.T
        offset = image[:, :2] / image[:, 2:] - seen.positions
        error = np.hypot(offset[:, 0], offset[:, 1])
    return np.where(np.isfinite(error) & (depth > MIN_DEPTH), error, np.inf), depth


def rays_through(K: Floats, positions: Floats) -> Floats:
    """Return the directions (x, y, 1) in the camera of positions in pixels."""
    return np.column_stack([(positions - K[:2, 2]) / K[0, 0], np.ones(len(positions))])


def stacked(poses: dict[int, Floats], frames: Indices) -> Floats:
    """Return the poses (N, 3, 4) of frames that have one."""
    if not len(frames):
        return np.empty((0, 3, 4))
    numbers, inverse = np.unique(frames, return_inverse=True)
    return np.stack([poses[int(number)] for number in numbers])[inverse]


def triangulate(structure: Structure, seen: Observations) -> tuple[Indices, Floats]:
    """Find points from all frames that see them: their numbers and positions, where they are well determined.

    What does not agree with a point is dropped once, and the point found anew.
    """
    numbers, points, errors = _triangulated(structure, seen)
    agreeing = errors <= np.maximum(MAX_ERROR_PX, _medians(seen.points, errors))
    if not agreeing.all():
        seen = seen[agreeing]
        numbers, points, errors = _triangulated(structure, seen)
    _, which, count = np.unique(seen.points, return_inverse=True, return_counts=True)
    worst = np.zeros(len(numbers))
    np.maximum.at(worst, which, errors)
    rays = rays_through(structure.K, seen.positions)
    angles = widest_angles_deg(stacked(structure.poses, seen.frames), rays, which, len(numbers))
    good = (count >= 2) & (worst <= MAX_ERROR_PX) & (angles >= MIN_ANGLE_DEG)
    return numbers[good], points[good]


def _triangulated(structure: Structure, seen: Observations) -> tuple[Indices, Floats, Floats]:
    """Return numbers and positions of points, and the error of every observation."""
    numbers, which = np.unique(seen.points, return_inverse=True)
    poses = stacked(structure.poses, seen.frames)
    rays = rays_through(structure.K, seen.positions)
    points = _linear(poses, rays, which, len(numbers))
    for _ in range(NUM_STEPS):
        points = _step(poses, rays, which, points)
    trial = replace(structure, points=points)
    errors, _ = reprojection(trial, Observations(seen.frames, which.astype(np.int64), seen.positions))
    return numbers, points, errors


def _medians(numbers: Indices, values: Floats) -> Floats:
    """Return for every line the lower median of the lines with the same number."""
    order = np.lexsort((values, numbers))
    _, start, which, count = np.unique(
        numbers[order], return_index=True, return_inverse=True, return_counts=True
    )
    median = np.empty(len(values))
    median[order] = values[order][(start + (count - 1) // 2)[which]]
    return median


def widest_angles_deg(poses: Floats, rays: Floats, which: Indices, count: int) -> Floats:
    """Measure the angle between the rays to each point: the largest to that of the first frame."""
    world = np.einsum("nij,ni->nj", poses[:, :, :3], rays / np.linalg.norm(rays, axis=1, keepdims=True))
    first = np.full(count, len(which), np.int64)
    np.minimum.at(first, which, np.arange(len(which)))
    cosine = np.clip((world * world[first[which]]).sum(axis=1), -1.0, 1.0)
    least = np.ones(count)
    np.minimum.at(least, which, cosine)
    return np.degrees(np.arccos(least))


def _linear(poses: Floats, rays: Floats, which: Indices, count: int) -> Floats:
    """Solve the homogeneous equations of all points."""
    rows = rays[:, :2, None] * poses[:, 2:3] - poses[:, :2]
    normal = np.zeros((count, 4, 4))
    np.add.at(normal, which, np.einsum("nki,nkj->nij", rows, rows))
    found = np.linalg.eigh(normal)[1][:, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(found[:, :3] / found[:, 3:])


def _step(poses: Floats, rays: Floats, which: Indices, points: Floats) -> Floats:
    """Make a Gauss-Newton step of all points."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inside = np.einsum("nij,nj->ni", poses[:, :, :3], points[which]) + poses[:, :, 3]
        place = inside[:, :2] / inside[:, 2:]
        jacobian = (poses[:, :2, :3] - place[:, :, None] * poses[:, 2:3, :3]) / inside[:, 2, None, None]
        residual = rays[:, :2] - place
    normal, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    np.add.at(normal, which, np.einsum("nki,nkj->nij", jacobian, jacobian))
    np.add.at(right, which, np.einsum("nki,nk->ni", jacobian, residual))
    usable = np.isfinite(normal).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
    normal[~usable], right[~usable] = np.eye(3), np.nan
    trace = np.einsum("nii->n", normal)
    normal += (1e-9 * trace + 1e-300)[:, None, None] * np.eye(3)
    return np.asarray(points + np.linalg.solve(normal, right[:, :, None])[:, :, 0])
