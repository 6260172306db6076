"""Frames whose motion is known exactly."""

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from dvc.video import Frame, chroma_shape


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
