"""Tileable textures: photographs that scikit-image carries, and materials synthesised from noise.

A texture is a square of linear reflectance that repeats without a seam. Relief is drawn into it as if lit
from its upper left, so that the surface stays Lambertian and looks the same from everywhere.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sequences._kernels import LEAF, Textures
from sequences.patterns import SIZE, cells, coloured, courses, photograph, relief, spectral_noise

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Material:
    """How a texture is made and laid on a surface."""

    # function of a random generator to an array of shape (SIZE, SIZE, 3), linear reflectance in [0, 1]
    make: Callable[[np.random.Generator], Floats]
    tile_m: float  # side of one tile, metres
    macro: float = 0.0  # strength of the large stains that hide the repetition
    kind: int = 0  # 0 for plain Lambertian, `LEAF` for thin things lit from both sides


def _per_stone(rng: np.random.Generator, owner: NDArray[np.int64], spread: float) -> Floats:
    return np.asarray(np.exp(spread * rng.standard_normal(int(owner.max()) + 1))[owner])


def _grain(name: str, strength: float) -> Floats:
    return np.asarray((photograph(name) / 0.25) ** strength)


def _macro(rng: np.random.Generator) -> Floats:
    return coloured(np.clip(0.5 + 0.2 * spectral_noise(rng, 1.5), 0.0, 1.0), (1, 1, 1))


def _clouds(rng: np.random.Generator) -> Floats:
    density = spectral_noise(rng, 1.8, 3, 200)
    cover = np.clip(0.30 + 0.75 * density, 0.0, 1.0)
    light = np.clip(0.75 - 0.25 * density + 0.12 * spectral_noise(rng, 1.3), 0.0, 1.0)
    return np.stack([cover, light, light], axis=-1)


def _plaster(rng: np.random.Generator) -> Floats:
    blotches = 1.0 + 0.05 * spectral_noise(rng, 1.4, 1, 60) + 0.06 * spectral_noise(rng, 0.4, 20)
    cracks = np.abs(spectral_noise(rng, 1.3, 2, 90))
    cracks = np.where((cracks < 0.035) & (spectral_noise(rng, 2, 1, 5) > 0.7), 0.72, 1.0)
    return coloured(0.62 * blotches * cracks * relief(spectral_noise(rng, 0.9), 0.05), (1, 1, 1))


def _brick(rng: np.random.Generator) -> Floats:
    body, owner = courses(rng, 16, 5, 5.0, 0.9)
    surface = _per_stone(rng, owner, 0.24) * _grain("gravel", 0.18) * relief(spectral_noise(rng, 0.7), 0.05)
    warm = np.stack(
        [0.30 + 0 * body, 0.135 * _per_stone(rng, owner, 0.1), 0.09 * _per_stone(rng, owner, 0.12)], -1
    )
    mortar = coloured(0.36 * _grain("gravel", 0.25), (1.0, 0.95, 0.86))
    mixed = body[..., None] * warm * surface[..., None] + (1 - body[..., None]) * mortar
    return np.asarray(np.clip(mixed * relief(body, 0.16)[..., None], 0, 1))


def _ashlar(rng: np.random.Generator) -> Floats:
    body, owner = courses(rng, 5, 3, 4.0, 0.6)
    surface = (
        0.42 * _per_stone(rng, owner, 0.10) * (1 + 0.06 * spectral_noise(rng, 1.0)) * _grain("gravel", 0.10)
    )
    surface *= relief(body + 0.15 * spectral_noise(rng, 1.0), 0.18) * (0.55 + 0.45 * body)
    return coloured(surface, (1.0, 0.93, 0.80))


def _stone(rng: np.random.Generator) -> Floats:
    base = (
        0.38
        * (1 + 0.13 * spectral_noise(rng, 1.3) + 0.07 * spectral_noise(rng, 0.3, 30))
        * _grain("gravel", 0.14)
    )
    lichen = np.clip(spectral_noise(rng, 1.5, 3, 120) - 1.25, 0, 1)[..., None]
    stained = base * (1 - 0.45 * np.clip(spectral_noise(rng, 1.7, 1, 60) - 0.6, 0, 1)) * relief(base, 1.2)
    return np.asarray(
        coloured(stained, (1.0, 0.95, 0.86)) * (1 - lichen) + lichen * np.array([0.42, 0.42, 0.26])
    )


def _asphalt(rng: np.random.Generator) -> Floats:
    small = np.tile(photograph("gravel")[::2, ::2], (2, 2)) / 0.25
    base = 0.105 * small**0.42 * (1 + 0.10 * spectral_noise(rng, 1.5, 1, 60))
    cracks = np.where(
        (np.abs(spectral_noise(rng, 1.4, 2, 80)) < 0.03) & (spectral_noise(rng, 2, 1, 4) > 0.4), 0.55, 1
    )
    return coloured(base * cracks, (1.0, 0.98, 0.95))


def _paving(rng: np.random.Generator) -> Floats:
    body, owner = courses(rng, 4, 4, 5.0, 0.8)
    surface = (
        0.33 * _per_stone(rng, owner, 0.11) * _grain("gravel", 0.12) * (1 + 0.09 * spectral_noise(rng, 1.4))
    )
    spots = np.where(spectral_noise(rng, 0.6, 8, 60) > 2.6, 0.55, 1.0)
    return coloured(surface * spots * (0.38 + 0.62 * body) * relief(body, 0.2), (1.0, 0.96, 0.90))


def _cobbles(rng: np.random.Generator) -> Floats:
    height, owner = cells(rng, 14, 0.16)
    dome = np.minimum(height * 3.2, 1.0) ** 0.6
    surface = 0.29 * _per_stone(rng, owner, 0.20) * _grain("gravel", 0.25) * (0.22 + 0.78 * dome)
    warm = _per_stone(rng, owner, 0.06)
    colour = np.stack([1.0 * warm, 0.95 + 0 * warm, 0.88 / warm], axis=-1)
    return coloured(surface * relief(dome, 0.35), colour)


def _wood(rng: np.random.Generator) -> Floats:
    grain = spectral_noise(rng, 0.9, 2, 250, stretch=0.03)
    plank = np.arange(SIZE) % (SIZE // 6)
    gap = np.where((plank < 4)[None, :], 0.35, 1.0)
    return coloured(
        0.30 * np.exp(0.26 * grain) * gap * (1 + 0.1 * spectral_noise(rng, 1.5)), (1.0, 0.66, 0.40)
    )


def _paint(rng: np.random.Generator) -> Floats:
    return coloured(0.55 * (1 + 0.06 * spectral_noise(rng, 1.2) + 0.03 * spectral_noise(rng, 0.2)), (1, 1, 1))


def _glass(rng: np.random.Generator) -> Floats:
    """Draw sixteen windows in a 4x4 sheet: dark rooms, curtains, blinds and a soft image of the sky."""
    sheet = np.empty((SIZE, SIZE, 3))
    side = SIZE // 4
    y, x = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side), indexing="ij")
    for k in range(16):
        room = (
            0.020
            + 0.03 * rng.random()
            + 0.03 * np.exp(-(((x - rng.random()) / 0.2) ** 2) - ((y - 0.5) / 0.4) ** 2)
        )
        pane = coloured(room, (1.0, 0.95, 0.9))
        width = rng.uniform(0.08, 0.34, 2)
        folds = 0.26 + 0.09 * np.sin(2 * np.pi * (rng.uniform(9, 15) * x + 0.6 * np.sin(3 * y)))
        curtain = (x < width[0]) | (x > 1 - width[1]) if rng.random() < 0.7 else y < rng.uniform(0.0, 0.6)
        tint = 1.0 - rng.uniform(0, 0.35, 3) * (rng.random() < 0.6)
        pane[curtain] = coloured(folds, tint)[curtain]
        reflection = np.clip(1.1 - np.abs(y - rng.uniform(-0.1, 0.4) + 0.35 * x) * 1.8, 0, 1) * rng.uniform(
            0.03, 0.2
        )
        pane += reflection[..., None] * np.array([0.8, 0.95, 1.1])
        sheet[side * (k // 4) : side * (k // 4 + 1), side * (k % 4) : side * (k % 4 + 1)] = pane
    return np.asarray(np.clip(sheet * (1 + 0.05 * spectral_noise(rng, 1.2))[..., None], 0, 1))


def _leaf(rng: np.random.Generator) -> Floats:
    return coloured(0.5 * (1 + 0.22 * spectral_noise(rng, 0.8)), (1, 1, 1))


def _grass(rng: np.random.Generator) -> Floats:
    dry = np.clip(0.5 + 0.4 * spectral_noise(rng, 1.6, 1, 30), 0, 1)[..., None]
    hue = (1 - dry) * np.array([0.50, 0.86, 0.24]) + dry * np.array([0.86, 0.86, 0.42])
    return coloured(0.85 * photograph("grass"), hue)


def _gravel(_rng: np.random.Generator) -> Floats:
    return coloured(photograph("gravel"), (1.1, 1.0, 0.85))


def _tiles(rng: np.random.Generator) -> Floats:
    body, owner = courses(rng, 14, 12, 4.0, 0.6)
    y = np.arange(SIZE)[:, None] / SIZE * 14 % 1.0
    surface = _per_stone(rng, owner, 0.2) * (0.5 + 0.6 * y) * (0.4 + 0.6 * body) * _grain("gravel", 0.2)
    return coloured(0.5 * surface, (0.50, 0.24, 0.16))


def _bark(rng: np.random.Generator) -> Floats:
    ridges = np.abs(spectral_noise(rng, 0.8, 3, 200, stretch=0.15))
    return coloured(0.20 * (0.3 + 0.9 * np.minimum(ridges, 1.4)) * relief(ridges, 0.3), (1.0, 0.84, 0.66))


def _marble(rng: np.random.Generator) -> Floats:
    grain = 1 + 0.10 * spectral_noise(rng, 1.2) + 0.08 * spectral_noise(rng, 0.3, 40)
    grime = np.clip(spectral_noise(rng, 1.5, 1, 90, stretch=0.3) - 0.4, 0, 1.5)
    spots = np.where(spectral_noise(rng, 0.5, 10, 70) > 2.3, 0.6, 1.0)
    return coloured(0.50 * grain * spots * (1 - 0.36 * grime), (1.0, 0.95, 0.85))


def _poster(name: str) -> Callable[[np.random.Generator], Floats]:
    def make(_rng: np.random.Generator) -> Floats:
        import cv2
        from skimage import data

        image = cv2.resize(getattr(data, name)(), (SIZE, SIZE), interpolation=cv2.INTER_AREA) / 255.0
        return np.asarray(0.05 + 0.75 * image**2.2, dtype=np.float64)

    return make


MATERIALS: dict[str, Material] = {
    "macro": Material(_macro, 1.0),
    "clouds": Material(_clouds, 1.0),
    "plaster": Material(_plaster, 2.4, 0.16),
    "brick": Material(_brick, 1.2, 0.18),
    "ashlar": Material(_ashlar, 2.2, 0.16),
    "stone": Material(_stone, 1.6, 0.20),
    "asphalt": Material(_asphalt, 2.2, 0.24),
    "paving": Material(_paving, 2.0, 0.20),
    "cobbles": Material(_cobbles, 1.9, 0.22),
    "wood": Material(_wood, 1.0, 0.12),
    "paint": Material(_paint, 1.5, 0.10),
    "glass": Material(_glass, 1.0),
    "leaf": Material(_leaf, 0.8, 0.0, LEAF),
    "grass": Material(_grass, 1.6, 0.20),
    "gravel": Material(_gravel, 1.3, 0.15),
    "tiles": Material(_tiles, 2.4, 0.20),
    "bark": Material(_bark, 0.8, 0.15),
    "marble": Material(_marble, 1.1, 0.12),
    "coffee": Material(_poster("coffee"), 1.0),
    "rocket": Material(_poster("rocket"), 1.0),
}
NUMBER = {name: i for i, name in enumerate(MATERIALS)}


def build(names: Iterable[str], seed: int) -> Textures:
    """Make the named textures with all their mip levels; others stay black."""
    wanted = set(names) | {"macro", "clouds"}
    levels = SIZE.bit_length()
    offsets = np.zeros((len(MATERIALS), levels), dtype=np.int64)
    texels, start = [np.zeros(3 * SIZE * SIZE, dtype=np.uint8)], 3 * SIZE * SIZE
    for number, (name, material) in enumerate(MATERIALS.items()):
        if name not in wanted:
            continue
        image = material.make(np.random.default_rng([seed, number]))
        for level in range(levels):
            offsets[number, level] = start
            texels.append(np.round(255.0 * np.sqrt(np.clip(image, 0.0, 1.0))).astype(np.uint8).ravel())
            start += texels[-1].size
            if level < levels - 1:
                image = image.reshape(image.shape[0] // 2, 2, image.shape[1] // 2, 2, 3).mean(axis=(1, 3))
    table = list(MATERIALS.values())
    return Textures(
        np.concatenate(texels),
        offsets,
        SIZE,
        np.array([1.0 / material.tile_m for material in table]),
        np.array([material.macro for material in table]),
        np.array([material.kind for material in table], dtype=np.int32),
    )
