"""A scene of two textured planes, rendered exactly: a slanted wall and a board before it."""

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import PixelFrame, project
from sfm.scene_model import Correspondences, Model

Floats = NDArray[np.float64]

WALL = np.array([-0.3, 0.1, 1.0, -4.0])
"""Plane of the wall: its product with a homogeneous point is 0."""
BOARD_DEPTH, BOARD_HALF = 2.2, (0.35, 0.4)


def camera_at(position: float) -> Floats:
    """Return the camera of a temporal position, [R | t], focal length of one unit, Frobenius norm sqrt(3)."""
    angle = 0.02 * position
    rotation = np.array(
        [[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]]
    )
    centre = position * np.array([0.25, 0.02, 0.08])
    camera = np.column_stack([rotation, -rotation @ centre])
    return camera * np.sqrt(3.0) / np.linalg.norm(camera)


def texture(x: Floats, y: Floats, kind: int) -> Floats:
    """Return smooth levels of a surface at coordinates on it."""
    rng = np.random.default_rng(kind)
    total = np.full(x.shape, 120.0 + 20.0 * kind)
    for _ in range(12):
        fx, fy, phase = rng.uniform(-22, 22), rng.uniform(-22, 22), rng.uniform(0, 6)
        total += 9.0 * np.sin(fx * x + fy * y + phase)
    return total


def render(position: float, frame: PixelFrame) -> tuple[NDArray[np.uint8], Floats]:
    """Return luma and inverse depth (in the view's own basis) of a temporal position."""
    camera = camera_at(position)
    y, x = np.mgrid[: frame.height_px, : frame.width_px].astype(np.float64)
    rays = frame.to_normalized(np.stack([x.ravel(), y.ravel()], axis=-1))
    rays = np.column_stack([rays, np.ones(len(rays))])
    inverse = np.linalg.inv(camera[:, :3])
    centre, directions = -inverse @ camera[:, 3], rays @ inverse.T
    wall = -(WALL[:3] @ centre + WALL[3]) / (directions @ WALL[:3])
    board = (BOARD_DEPTH - centre[2]) / directions[:, 2]
    at_wall, at_board = (centre + depth[:, None] * directions for depth in (wall, board))
    on_board = (np.abs(at_board[:, :2]) < BOARD_HALF).all(axis=1)
    levels = np.where(on_board, texture(*at_board[:, :2].T, 1), texture(*at_wall[:, :2].T / 2.0, 0))
    depth = np.where(on_board, board, wall)
    shape = (frame.height_px, frame.width_px)
    luma = np.clip(np.round(levels), 0, 255).astype(np.uint8)
    return luma.reshape(shape), (1.0 / depth).reshape(shape)


def two_planes(width: int = 96, height: int = 80, noise_px: float = 0.05) -> Model:
    """Return the model of the scene, with correspondences that both key frames see."""
    frame, rng = PixelFrame(width, height), np.random.default_rng(3)
    points = rng.uniform(0, 1, (400, 2)) * [width - 1, height - 1]
    _, inverse = render(0.0, frame)
    scale = float(np.sqrt(3.0) / np.linalg.norm(np.eye(3)))
    row, column = np.round(points[:, 1]).astype(int), np.round(points[:, 0]).astype(int)
    depths = scale / inverse[row, column]
    normalized = frame.to_normalized(points)
    world = np.column_stack([depths[:, None] * normalized, depths, np.ones(len(depths))])
    second, _ = project(camera_at(1.0), world)
    pixels = frame.to_pixels(second)
    seen = ((pixels >= 0) & (pixels <= [width - 1, height - 1])).all(axis=1)
    pixels += rng.normal(0, noise_px, pixels.shape)
    matches = Correspondences(points[seen], pixels[seen], np.zeros(seen.sum()))
    return Model(frame, np.eye(3), camera_at(1.0), matches, depths[seen])
