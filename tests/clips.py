"""Small synthetic videos whose motion is known exactly."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from dvc.video import Frame, chroma_shape, create_video
from dvc.video.frames import Plane


def moving_texture(
    num_frames: int, height: int, width: int, motion_px: tuple[float, float] = (1.0, 2.0), seed: int = 0
) -> list[Frame]:
    """Return frames of one smooth random texture under a constant translation."""
    rng = np.random.default_rng(seed)
    margin = 4 * num_frames + 8
    fine = gaussian_filter(rng.normal(size=(height + 2 * margin, width + 2 * margin)), 1.2)
    coarse = gaussian_filter(rng.normal(size=fine.shape), 6.0)
    texture = 128.0 + 30.0 * fine / fine.std() + 25.0 * coarse / coarse.std()
    rows, columns = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
    half = chroma_shape(height, width)
    frames = []
    for index in range(num_frames):
        down, right = (component * index for component in motion_px)
        sampled = map_coordinates(texture, [rows + margin - down, columns + margin - right], order=3)
        luma = np.clip(np.round(sampled), 16, 235).astype(np.uint8)
        chroma = np.full(half, 110, np.uint8), np.full(half, 140 + index % 8, np.uint8)
        frames.append(Frame(luma, chroma))
    return frames


def write_clip(path: Path, frames: Sequence[Frame]) -> Path:
    """Write frames as a video of 25 frames per second."""
    with create_video(path, (frames[0].width, frames[0].height), Fraction(25)) as writer:
        for frame in frames:
            writer.write(frame)
    return path


def odd_frames() -> dict[str, Plane]:
    """Return frames without texture, of noise, and of odd sizes."""
    rng = np.random.default_rng(0)
    texture = moving_texture(1, 120, 160)[0].luma
    return {
        "black": np.zeros((48, 64), np.uint8),
        "white": np.full((48, 64), 255, np.uint8),
        "noise": rng.integers(0, 256, (48, 64)).astype(np.uint8),
        "16x16": rng.integers(0, 256, (16, 16)).astype(np.uint8),
        "1x1": np.zeros((1, 1), np.uint8),
        "odd": texture[:37, :53],
        "narrow": texture[:9],
    }


def same_frame(a: Frame, b: Frame) -> bool:
    """Tell whether two pictures are equal sample for sample; grey never equals colour."""
    if (a.chroma is None) != (b.chroma is None):
        return False
    pairs = zip((a.luma, *(a.chroma or ())), (b.luma, *(b.chroma or ())), strict=True)
    return all(np.array_equal(x, y) for x, y in pairs)
