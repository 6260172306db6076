"""Patterns that textures are mixed from: noise, relief, stones, courses, photographs; all without a seam."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

SIZE = 512
"""Side of a tile in texels."""


def spectral_noise(
    rng: np.random.Generator,
    slope: float,
    min_frequency: float = 1.0,
    max_frequency: float = SIZE / 2,
    stretch: float = 1.0,
) -> Floats:
    """Draw periodic Gaussian noise whose amplitude falls as ``1 / frequency**slope``, mean 0, deviation 1."""
    rows, columns = np.fft.fftfreq(SIZE, 1 / SIZE)[:, None], np.fft.rfftfreq(SIZE, 1 / SIZE)[None, :]
    radius = np.hypot(rows / np.sqrt(stretch), columns * np.sqrt(stretch))
    gain = np.where(
        (radius >= min_frequency) & (radius <= max_frequency), np.maximum(radius, 0.5) ** -slope, 0.0
    )
    noise = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((SIZE, SIZE))) * gain, s=(SIZE, SIZE))
    return np.asarray((noise - noise.mean()) / noise.std(), dtype=np.float64)


def relief(height: Floats, depth: float) -> Floats:
    """Return the shading (about 1) of a height map that is lit from the upper left."""
    slope = np.roll(height, 1, 0) - np.roll(height, -1, 0) + np.roll(height, 1, 1) - np.roll(height, -1, 1)
    return np.asarray(np.clip(1.0 - depth * slope, 0.35, 1.6), dtype=np.float64)


def cells(rng: np.random.Generator, across: int, disorder: float) -> tuple[Floats, NDArray[np.int64]]:
    """Cut a tile into ``across**2`` rounded stones."""
    from scipy.spatial import cKDTree

    i, j = np.meshgrid(np.arange(across), np.arange(across), indexing="ij")
    seeds = np.stack([i + 0.5, j + 0.5 + 0.5 * (i % 2)], axis=-1) + rng.uniform(
        -disorder, disorder, (across, across, 2)
    )
    tree = cKDTree(np.mod(seeds.reshape(-1, 2), across), boxsize=across)
    axis = (np.arange(SIZE) + 0.5) * across / SIZE
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    distance, owner = tree.query(grid.reshape(-1, 2), k=2)
    height = 0.5 * (distance[:, 1] - distance[:, 0])
    return height.reshape(SIZE, SIZE), owner[:, 0].reshape(SIZE, SIZE)


def courses(
    rng: np.random.Generator, rows: int, columns: int, joint: float, ragged: float = 0.0
) -> tuple[Floats, NDArray[np.int64]]:
    """Lay a tile in courses with half a stone of offset: bricks, slabs, ashlar, roof tiles."""
    wobble = ragged * spectral_noise(rng, 0.8, 4, 120), ragged * spectral_noise(rng, 0.8, 4, 120)
    y, x = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5, indexing="ij")
    v = np.mod(y + wobble[0], SIZE) / SIZE * rows
    row = v.astype(np.int64) % rows
    shift = np.where(np.arange(rows) % 2 == 1, 0.5, 0.0) + rng.uniform(-0.06, 0.06, rows)
    u = np.mod((x + wobble[1]) / SIZE * columns + shift[row], columns)
    column = u.astype(np.int64) % columns
    to_edge_v = np.minimum(v - np.floor(v), np.ceil(v) - v) * SIZE / rows
    to_edge_u = np.minimum(u - np.floor(u), np.ceil(u) - u) * SIZE / columns
    body = np.clip((np.minimum(to_edge_u, to_edge_v) - joint / 2) / 1.6 + 0.5, 0.0, 1.0)
    return body, row * columns + column


def photograph(name: str) -> Floats:
    """Return a grey photograph of scikit-image, 512x512, made seamless, as linear values with mean 0.25."""
    from skimage import data

    image = (getattr(data, name)().astype(np.float64) / 255.0) ** 2.2
    ramp = np.clip(np.minimum(np.arange(SIZE), SIZE - 1 - np.arange(SIZE)) / 64.0, 0.0, 1.0)
    weight = np.minimum(ramp[:, None], ramp[None, :])
    other = np.roll(image, (SIZE // 2, SIZE // 2), (0, 1))
    centred = weight * (image - image.mean()) + (1 - weight) * (other - image.mean())
    mixed = centred / np.sqrt(weight**2 + (1 - weight) ** 2) + image.mean()
    return np.asarray(np.clip(mixed, 0.004, None) * (0.25 / mixed.mean()), dtype=np.float64)


def coloured(grey: Floats, colour: ArrayLike) -> Floats:
    """Multiply a grey map (SIZE, SIZE) with a linear colour (3,) or a map of colours."""
    return np.asarray(np.clip(grey[..., None] * np.asarray(colour, dtype=np.float64), 0.0, 1.0))
