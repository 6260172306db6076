"""Small synthetic videos whose motion is known exactly."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from dvc.contracts.side_information import moving_texture
from dvc.video import Frame, create_video
from dvc.video.frames import Plane

__all__ = ["moving_texture", "odd_frames", "same_frame", "write_clip"]


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
