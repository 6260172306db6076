"""Exact tracks of a camera that moves past random points."""

import numpy as np

from dvc.arrays import Floats
from sfm.mapping.sequence_tracks import SequenceTracks, VisiblePoints

WIDTH, HEIGHT, FOCAL = 320, 240, 400.0
K = np.array([[FOCAL, 0.0, 0.5 * (WIDTH - 1)], [0.0, FOCAL, 0.5 * (HEIGHT - 1)], [0.0, 0.0, 1.0]])


def pose_of(index: float, step: float = 0.12, turn: float = 0.012) -> Floats:
    """Return the pose of a frame: to the right and a little up, and turning back to the scene."""
    angle = turn * index
    R = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
    centre = step * index * np.array([1.0, -0.1, 0.15 * np.sin(0.3 * index)])
    return np.column_stack([R, -R @ centre])


def scene(count: int = 500, seed: int = 1) -> Floats:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-5, 8, count), rng.uniform(-3, 3, count), rng.uniform(4, 9, count)])


def seen_by(
    pose: Floats, points: Floats, first_id: int = 0, noise_px: float = 0.0, seed: int = 0
) -> VisiblePoints:
    image = (points @ pose[:, :3].T + pose[:, 3]) @ K.T
    place = image[:, :2] / image[:, 2:]
    inside = (image[:, 2] > 0) & ((place >= 0) & (place <= [WIDTH - 1, HEIGHT - 1])).all(axis=1)
    noise = np.random.default_rng(seed).normal(0.0, noise_px, (int(inside.sum()), 2))
    return VisiblePoints(first_id + np.flatnonzero(inside), place[inside] + noise)


def tracks_of(poses: list[Floats], points: Floats, noise_px: float = 0.0, spacing: int = 2) -> SequenceTracks:
    """Return the tracks of all frames, of which every few are key frames."""
    seen = tuple(seen_by(pose, points, 0, noise_px, k) for k, pose in enumerate(poses))
    keys = tuple(sorted({*range(0, len(poses), spacing), len(poses) - 1}))
    return SequenceTracks(WIDTH, HEIGHT, seen, keys, len(points))
