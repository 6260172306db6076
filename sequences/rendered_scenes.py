"""Scenes that are built and lit, and their pictures with exact depth and camera."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dvc.arrays import Bytes, Floats, Singles
from dvc.errors import ConfigError
from dvc.video.frames import Frame, check_size
from sequences import _kernels
from sequences._kernels import Light, Materials
from sequences.scene_cameras import Camera, intrinsics, look_at, transformed
from sequences.scene_layouts import ARRAY_SCENES, VIDEO_SCENES
from sequences.scenery import Description
from sequences.shapes import MATERIALS, Colour, Mesh

SUN_DISTANCE_M = 2000.0
SUN: Colour = (2.7, 2.4, 1.95)
SKY: Colour = (0.62, 0.74, 0.92)
GROUND: Colour = (0.3, 0.27, 0.23)
HAZE: Colour = (0.66, 0.76, 0.90)
ZENITH: Colour = (0.15, 0.29, 0.62)


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene that is built and lit, ready to be rendered from any camera.

    Attributes
    ----------
    description : Description
        Name, frame rate, motion.
    seed : int
        Seed of textures, plants and tremor.
    surface : Mesh
        Triangles.
    materials : Materials
        Table of textures.
    light : Light
        Sun, sky, haze.
    """

    description: Description
    seed: int
    surface: Mesh
    materials: Materials
    light: Light

    def camera(self, index: float, width: int = 352, height: int = 288) -> Camera:
        """Return the camera of a frame.

        Parameters
        ----------
        index : float
            Frame number, from 0; fractions lie between frames.
        width, height : int
            Image size in pixels.

        Returns
        -------
        Camera
            Intrinsics and pose.
        """
        k = intrinsics(width, height, self.description.field_of_view_deg)
        return Camera(k, self.description.pose(index, self.seed), width, height)


@lru_cache(maxsize=3)
def scene(name: str, seed: int = 0) -> Scene:
    """Build a scene; the last three are cached.

    Parameters
    ----------
    name : str
        ``"street"``, ``"stairway"``, ``"statue"``, ``"rounds"`` or ``"toy"``.
    seed : int
        Seed of textures, plants and the tremor of the hand.

    Returns
    -------
    Scene
        Geometry, textures and light.

    Raises
    ------
    ConfigError
        If there is no scene of that name.
    ValueError
        If `seed` is negative.
    """
    if seed < 0:
        raise ValueError(f"`seed` must not be negative, got {seed}")
    described = VIDEO_SCENES | ARRAY_SCENES
    if name not in described:
        raise ConfigError(f"no scene is called {name!r}; the scenes are {', '.join(described)}")
    description = described[name]
    mesh = description.geometry(np.random.default_rng([seed, 1]))
    table = (np.array(column, dtype=np.float64) for column in zip(*MATERIALS.values(), strict=True))
    materials = Materials._make([*table, 1009 * seed])
    return Scene(description, seed, mesh, materials, illuminate(mesh, description))


def illuminate(mesh: Mesh, description: Description) -> Light:
    """Return the light of a scene, with the shadows of its mesh."""
    azimuth, elevation = np.radians(description.sun_deg)
    flat = math.cos(elevation)
    to_sun = np.array([math.sin(azimuth) * flat, math.cos(azimuth) * flat, math.sin(elevation)])
    centre, radius_m = np.array(description.shadows[0]), description.shadows[1]
    size = description.shadow_size
    focal, half = 0.5 * size * SUN_DISTANCE_M / radius_m, (size - 1) / 2
    k = np.array([[focal, 0.0, half], [0.0, focal, half], [0.0, 0.0, 1.0]])
    shadow_from_world = k @ look_at(centre + SUN_DISTANCE_M * to_sun, centre)
    inverse, ids = np.zeros((size, size), dtype=np.float32), np.full((size, size), -1, dtype=np.int32)
    _kernels.rasterize(transformed(shadow_from_world, mesh.points), mesh.triangles, inverse, ids)
    with np.errstate(divide="ignore"):
        shadow_depth = np.float32(1.0) / inverse
    colours = (np.array(colour, dtype=np.float64) for colour in (SUN, SKY, GROUND, HAZE, ZENITH))
    return Light._make([to_sun, *colours, shadow_from_world, shadow_depth])


@dataclass(frozen=True, eq=False)
class RenderedFrame:
    """A picture with its true depth and camera."""

    frame: Frame  # luma and chroma, BT.601 limited range, 4:2:0
    depth: Singles  # depth along the optical axis at the pixel centres, metres; inf for the sky
    camera: Camera


def render_frame(
    scene: Scene, index: int, width: int, height: int, *, samples: int = 3, noise_sigma: float = 0.0
) -> RenderedFrame:
    """Render one frame; the same arguments always give the same bytes."""
    if index < 0:
        raise ValueError(f"`index` must not be negative, got {index}")
    if samples < 1 or samples % 2 == 0:
        raise ValueError(f"`samples` must be odd and positive, got {samples}")
    if not 0.0 <= noise_sigma < 128.0:
        raise ValueError(f"`noise_sigma` must be in [0, 128), got {noise_sigma}")
    check_size(width, height, scene.description.name)
    camera = scene.camera(index, width, height)
    linear, depth = _radiance(scene, camera, samples)
    planes = ycbcr(tone(linear * scene.description.exposure))
    if noise_sigma > 0:
        rng = np.random.default_rng([scene.seed, index, 3])
        sigmas = noise_sigma, 0.5 * noise_sigma, 0.5 * noise_sigma
        noisy = [p + sigma * rng.standard_normal(p.shape) for p, sigma in zip(planes, sigmas, strict=True)]
        planes = noisy[0], noisy[1], noisy[2]
    return RenderedFrame(to_frame(planes), depth, camera)


def render_picture(scene: Scene, index: int, width: int, height: int) -> tuple[Bytes, Singles, Camera]:
    """Render a view of a camera array in RGB, without sensor noise."""
    check_size(width, height, scene.description.name)
    camera = scene.camera(index, width, height)
    linear, depth = _radiance(scene, camera, 3)
    coded = tone(linear * np.float32(scene.description.exposure))
    return np.clip(np.floor(255.0 * coded + 0.5), 0, 255).astype(np.uint8), depth, camera


def _radiance(scene: Scene, camera: Camera, samples: int) -> tuple[Singles, Singles]:
    """Return linear colour (H, W, 3) and depth (H, W) of a view."""
    height, width = camera.height_px, camera.width_px
    border = samples - 1
    shape = (samples * height + border, samples * width + border)
    k = camera.K.copy()
    k[:2] *= samples
    k[:2, 2] += border
    projected = transformed(k @ camera.cam_from_world, scene.surface.points)
    inverse, ids = np.zeros(shape, dtype=np.float32), np.full(shape, -1, dtype=np.int32)
    _kernels.rasterize(projected, scene.surface.triangles, inverse, ids)
    colour = np.empty((*shape, 3), dtype=np.float32)
    rays = camera.cam_from_world[:, :3].T @ np.linalg.inv(k)
    _kernels.shade(scene.surface, scene.materials, scene.light, projected, rays, ids, inverse, colour)
    taps = np.convolve(np.ones(samples), np.ones(samples)).astype(np.float32) / np.float32(samples**2)
    with np.errstate(divide="ignore"):
        depth = np.float32(1.0) / inverse[border::samples, border::samples][:height, :width]
    return resolve(colour, taps, samples), depth


def resolve(samples: Singles, taps: Singles, step: int) -> Singles:
    """Average samples into pixels, `step` samples apart, with a separable kernel of `taps`."""
    for _ in range(2):  # rows, then columns
        count = (len(samples) - len(taps)) // step + 1
        lines = [tap * samples[k : k + step * count : step][:count] for k, tap in enumerate(taps)]
        samples = np.swapaxes(sum(lines[1:], start=lines[0]), 0, 1)
    return samples


def tone(linear: Singles) -> Singles:
    """Map linear light to display values in [0, 1]: a filmic shoulder and toe, then the sRGB curve."""
    x = np.maximum(linear, 0.0)
    film = np.clip(x * (2.51 * x + 0.13) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)
    mixed = 0.75 * film + 0.25 * (1.0 - np.exp(-1.6 * x))
    coded = np.where(mixed <= 0.0031308, 12.92 * mixed, 1.055 * np.maximum(mixed, 1e-6) ** (1 / 2.4) - 0.055)
    return np.asarray(coded, dtype=np.float32)


def ycbcr(rgb: Singles) -> tuple[Floats, Floats, Floats]:
    """Convert gamma-coded RGB in [0, 1] to BT.601 limited range, chroma averaged over 2x2 pixels."""
    r, g, b = (rgb[..., i].astype(np.float64) for i in range(3))
    luma = 16.0 + 65.481 * r + 128.553 * g + 24.966 * b
    blue = 128.0 - 37.797 * r - 74.203 * g + 112.0 * b
    red = 128.0 + 112.0 * r - 93.786 * g - 18.214 * b
    padding = (0, len(luma) % 2), (0, luma.shape[1] % 2)
    cb, cr = (np.pad(plane, padding, mode="edge") for plane in (blue, red))
    cb, cr = (0.25 * (c[::2, ::2] + c[1::2, ::2] + c[::2, 1::2] + c[1::2, 1::2]) for c in (cb, cr))
    return luma, cb, cr


def to_frame(planes: tuple[Floats, Floats, Floats]) -> Frame:
    """Round to 8 bits."""
    y, b, r = (np.clip(np.floor(plane + 0.5), 0, 255).astype(np.uint8) for plane in planes)
    return Frame(y, (b, r))
