"""Pictures of a smooth texture whose motion is known exactly."""

from collections.abc import Callable

import numpy as np

from dvc.arrays import Bytes, Floats

Texture = Callable[[Floats, Floats], Floats]


def texture(seed: int, shortest_px: float = 5.0, longest_px: float = 16.0, contrast: float = 20.0) -> Texture:
    """Return a function of (x, y), a sum of waves: luma levels around 128."""
    rng = np.random.default_rng(seed)
    angle, phase = rng.uniform(0, 2 * np.pi, (2, 24))
    frequency = 2 * np.pi / rng.uniform(shortest_px, longest_px, 24)

    def luma(x: Floats, y: Floats) -> Floats:
        waves = np.cos(
            np.multiply.outer(x, frequency * np.cos(angle))
            + np.multiply.outer(y, frequency * np.sin(angle))
            + phase
        )
        values: Floats = 128.0 + contrast * waves.sum(axis=-1) * np.sqrt(2 / 24)
        return values

    return luma


def picture(luma: Texture, height: int, width: int, source: Floats | None = None) -> Bytes:
    """Sample a texture; `source` (2, 3) or (3, 3) maps pixels to where the texture is read."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    if source is not None:
        u = np.tensordot(source, np.stack([x, y, np.ones_like(x)]), axes=1)
        x, y = (u[0] / u[2], u[1] / u[2]) if len(u) == 3 else u
    return np.clip(np.rint(luma(x, y)), 0, 255).astype(np.uint8)


def shifted(luma: Texture, height: int, width: int, shift: tuple[float, float]) -> Bytes:
    """Sample a texture that has moved by `shift` (x, y) pixels."""
    return picture(luma, height, width, np.array([[1.0, 0.0, -shift[0]], [0.0, 1.0, -shift[1]]]))


def sideways(direction: tuple[float, float] = (1.0, 0.0)) -> Floats:
    """Return F of a camera that moves along its image plane: motions are along `direction`."""
    x, y = direction
    matrix = np.array([[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]])
    return matrix / np.linalg.norm(matrix)


def forwards(centre: tuple[float, float]) -> Floats:
    """Return F of a camera that moves along its optical axis: both epipoles are at `centre`."""
    x, y = centre
    matrix = np.array([[0.0, -1.0, y], [1.0, 0.0, -x], [-y, x, 0.0]])
    return matrix / np.linalg.norm(matrix)
