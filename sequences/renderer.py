"""Pictures of a built scene with exact depth and camera."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.video.frames import Frame, check_size
from sequences import _kernels
from sequences.rendered_scenes import Scene
from sequences.scene_cameras import Camera, transformed

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class RenderedFrame:
    """A picture with its true depth and camera."""

    frame: Frame  # luma and chroma, BT.601 limited range, 4:2:0
    depth: Singles  # depth along the optical axis at the pixel centres, metres; inf for the sky
    camera: Camera


def render_frame(
    scene: Scene,
    index: int,
    width: int = 352,
    height: int = 288,
    *,
    samples: int = 3,
    noise_sigma: float = 0.0,
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
    rng = np.random.default_rng([scene.seed, index, 3]) if noise_sigma > 0 else None
    return RenderedFrame(to_frame(planes, noise_sigma, rng), depth, camera)


def render_picture(
    scene: Scene, index: int, width: int, height: int, *, samples: int = 3
) -> tuple[NDArray[np.uint8], Singles, Camera]:
    """Render a view of a camera array in RGB, without sensor noise."""
    check_size(width, height, scene.description.name)
    camera = scene.camera(index, width, height)
    linear, depth = _radiance(scene, camera, samples)
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
    return luma, _halve(blue), _halve(red)


def _halve(plane: Floats) -> Floats:
    height, width = plane.shape
    even = np.pad(plane, ((0, height % 2), (0, width % 2)), mode="edge")
    return np.asarray(0.25 * (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]))


def to_frame(
    planes: tuple[Floats, Floats, Floats], noise_sigma: float, rng: np.random.Generator | None
) -> Frame:
    """Add sensor noise and round to 8 bits."""
    luma, cb, cr = planes
    if rng is not None:
        luma = luma + noise_sigma * rng.standard_normal(luma.shape)
        cb = cb + 0.5 * noise_sigma * rng.standard_normal(cb.shape)
        cr = cr + 0.5 * noise_sigma * rng.standard_normal(cr.shape)
    y, b, r = (np.clip(np.floor(plane + 0.5), 0, 255).astype(np.uint8) for plane in (luma, cb, cr))
    return Frame(y, (b, r))
