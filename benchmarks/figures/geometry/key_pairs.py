"""Key frames of rendered scenes and of clips, and where points of one really are in the next."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures.harness import clip_source
from dvc.keyframes import KeyFrameDecoder, KeyFrameEncoder
from dvc.video import Frame, open_video
from sequences.correspondences import Correspondences, correspondences, pixel_grid
from sequences.renderer import render_frame
from sequences.scenes import Scene, scene

SPACING = 10
GRID_STEP = 3
WIDTH, HEIGHT = 352, 288
Luma = NDArray[np.uint8]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class KeyPair:
    """Two key frames of a sequence, and the number of the first."""

    index: int
    first: Luma
    second: Luma


@cache
def _scene(name: str) -> Scene:
    return scene(name)


@cache
def _key_frames(name: str, count: int) -> tuple[Luma, ...]:
    numbers = range(0, SPACING * count, SPACING)
    return tuple(render_frame(_scene(name), number, WIDTH, HEIGHT).frame.luma for number in numbers)


def scene_pairs(name: str, num_gops: int, qp: int | None = None) -> list[KeyPair]:
    """Render the key frames of a scene."""
    frames: list[Luma] = list(_key_frames(name, num_gops + 1))
    if qp is not None:
        encoder = KeyFrameEncoder(WIDTH, HEIGHT, qp, luma_only=True)
        decoder = KeyFrameDecoder(WIDTH, HEIGHT, encoder.parameter_sets, luma_only=True)
        frames = [decoder.decode(encoder.encode(Frame(luma, None))).luma for luma in frames]
    pairs = pairwise(frames)
    return [KeyPair(SPACING * k, first, second) for k, (first, second) in enumerate(pairs)]


def clip_pairs(clip: str) -> Iterator[KeyPair]:
    """Read the key frames of all whole groups of pictures of a real clip."""
    previous: Luma | None = None
    with open_video(clip_source(clip).path) as reader:
        for number, frame in enumerate(reader):
            if number % SPACING == 0:
                if previous is not None:
                    yield KeyPair(number - SPACING, previous, frame.luma)
                previous = frame.luma


def truth(name: str, pair: KeyPair, points: Floats) -> Correspondences:
    """Look up where points of the first key frame are in the second."""
    return correspondences(_scene(name), pair.index, pair.index + SPACING, points, WIDTH, HEIGHT)


def true_correspondences(name: str, pair: KeyPair) -> tuple[Floats, Floats]:
    """Return points of the first key frame that the second sees too, and where they are there."""
    grid = pixel_grid(WIDTH, HEIGHT, GRID_STEP)
    found = truth(name, pair, grid)
    return found.points_a[found.visible], found.points_b[found.visible]
