"""Small synthetic videos whose motion is known exactly."""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import zip_longest
from pathlib import Path

import numpy as np

from dvc.contracts.test_side_information import moving_texture
from dvc.video import Frame, create_video
from dvc.video.frames import Plane

__all__ = ["moving_texture", "odd_frames", "raw_bytes", "same_frame", "same_frames", "write_clip"]


def raw_bytes(frames: Iterable[Frame]) -> bytes:
    """Return frames as a pipe brings them."""
    return b"".join(plane.tobytes() for frame in frames for plane in (frame.luma, *(frame.chroma or ())))


def write_clip(path: Path, frames: Sequence[Frame], rate: Fraction | int = 25, **options: bool) -> Path:
    """Write frames as a video, with options of `create_video`."""
    with create_video(path, (frames[0].width, frames[0].height), rate, **options) as writer:
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
    """Return whether two pictures are equal sample for sample; grey never equals colour."""
    if (a.chroma is None) != (b.chroma is None):
        return False
    pairs = zip((a.luma, *(a.chroma or ())), (b.luma, *(b.chroma or ())), strict=True)
    return all(np.array_equal(x, y) for x, y in pairs)


def same_frames(a: Iterable[Frame], b: Iterable[Frame]) -> bool:
    """Return whether two sequences have the same pictures."""
    return all(x and y and same_frame(x, y) for x, y in zip_longest(a, b))
