"""Maps with exact cameras and depth: a camera that flies before a wall with a board in front of it."""

from collections.abc import Callable

import cv2
import numpy as np

from dvc.arrays import Bytes, Floats, Singles
from dvc.video import Frame
from dvc.video.pixels import frame_from_rgb
from sfm.mapping.scene_map import MapPiece, SceneMap

WALL, BOARD, HALF_BOARD = 4.0, 2.5, 0.4
"""Distances of the two planes from the first camera, and half a side of the board."""


def pose_at(number: int) -> Floats:
    """Return the camera of a frame, from the world."""
    turn, _ = cv2.Rodrigues(np.array([0.01, -0.03, 0.004]) * number)
    centre = np.array([0.08, -0.02, 0.03]) * number
    return np.column_stack([turn, -turn @ centre])


def intrinsics_of(width: int, height: int) -> Floats:
    """Return a camera whose principal point is beside the middle."""
    focal = 0.9 * max(width, height)
    return np.array(
        [[focal, 0.0, 0.5 * (width - 1) + 1.25], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]]
    )


def colours_at(x: Floats, y: Floats, hue: float) -> Floats:
    """Return smooth colours of a plane at coordinates on it, shape (..., 3)."""
    waves = [0.5 + 0.4 * np.sin(3.0 * x + hue + k) * np.cos(2.0 * y + 2.0 * hue + k) for k in range(3)]
    return 255.0 * np.stack(waves, axis=-1)


def view(number: int, width: int, height: int) -> tuple[Bytes, Singles, Floats]:
    """Return picture, depth and places in the world of a frame."""
    pose, intrinsics = pose_at(number), intrinsics_of(width, height)
    y, x = np.mgrid[:height, :width].astype(np.float64)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(intrinsics).T
    centre, ahead = -pose[:, :3].T @ pose[:, 3], rays @ pose[:, :3]
    depth, board = ((plane - centre[2]) / ahead[..., 2] for plane in (WALL, BOARD))
    on_board = (np.abs((centre + board[..., None] * ahead)[..., :2]) < HALF_BOARD).all(axis=-1)
    depth = np.where(on_board, board, depth)
    places = centre + depth[..., None] * ahead
    colours = [colours_at(places[..., 0], places[..., 1], hue) for hue in (0.0, 2.0)]
    levels = np.where(on_board[..., None], colours[1], colours[0])
    return np.rint(levels).astype(np.uint8), depth.astype(np.float32), places


def piece_of(numbers: range, width: int, height: int, depth_step: int = 2) -> MapPiece:
    """Return the piece of some frames, with the depth of some of them; a corner of each is not known."""
    depths, points, colours = {}, [], []
    for number in numbers[::depth_step]:
        picture, depth, places = view(number, width, height)
        depth[:3, :3] = np.nan
        depths[number] = depth
        points.append(places[4::3, 4::3].reshape(-1, 3))
        colours.append(picture[4::3, 4::3].reshape(-1, 3))
    poses = {number: pose_at(number) for number in numbers}
    cloud, cloud_colours = np.concatenate(points), np.concatenate(colours)
    return MapPiece(intrinsics_of(width, height), poses, cloud, cloud_colours, depths)


def map_of(*pieces: MapPiece, size: tuple[int, int], num_frames: int = 12) -> SceneMap:
    return SceneMap(*size, num_frames, pieces)


def frames_of(width: int, height: int) -> Callable[[int], Frame]:
    return lambda number: frame_from_rgb(view(number, width, height)[0])
