"""Motion refinement during decoding."""

import numpy as np
import pytest

from decoder.side_information.block_motion import refinement
from decoder.side_information.block_motion.compensation import compensate_chroma
from decoder.side_information.block_motion.refinement import BLOCK, BlockRefiner
from dvc.metrics import psnr_db
from dvc.video import Frame
from dvc.wynerziv.transform import to_uint8
from tests.clips import moving_texture

MOTION_PX = (1.0, -2.0)


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """Return two references and the frame between them."""
    return moving_texture(3, 32, 48, MOTION_PX)


def refiner_with(error_px: float, frames: list[Frame]) -> BlockRefiner:
    shape = (32 // BLOCK, 48 // BLOCK, 2)
    towards = 4 * (np.array(MOTION_PX) + error_px)
    offsets = [np.broadcast_to(sign * towards, shape).astype(np.int64) for sign in (-1, 1)]
    return BlockRefiner([frames[0], frames[2]], offsets, "test")


def test_wrong_motion_is_corrected(frames: list[Frame]) -> None:
    """Guided by the truth, offsets that are wrong by two pixels find back, and keep improving."""
    refiner = refiner_with(2.0, frames)
    inside = np.s_[6:-6, 6:-6]
    quality = [psnr_db(frames[0].luma[inside], frames[1].luma[inside])]
    for _ in range(3):
        prediction = refiner.refine(frames[1].luma)
        quality.append(psnr_db(to_uint8(prediction.luma)[inside], frames[1].luma[inside]))
    assert quality[1] > quality[0] + 10
    assert quality[-1] > 38
    assert prediction.refiner is refiner
    assert prediction.method == "test"


def test_the_reference_that_sees_the_block_wins(frames: list[Frame]) -> None:
    """Where one reference is painted over, the prediction comes from the other."""
    spoilt = np.full_like(frames[0].luma, 16)
    shape = (32 // BLOCK, 48 // BLOCK, 2)
    offsets = [np.zeros(shape, np.int64), np.zeros(shape, np.int64)]
    refiner = BlockRefiner([Frame(spoilt), Frame(frames[1].luma)], offsets, "test")
    prediction = refiner.refine(frames[1].luma)
    assert psnr_db(to_uint8(prediction.luma), frames[1].luma) > 30


def test_references_are_held_once(frames: list[Frame]) -> None:
    """Frames that are decoded side by side share what is made of their references while one needs it."""
    before = len(refinement._in_use)
    first, second = refiner_with(0.0, frames), refiner_with(1.0, frames)
    other = refiner_with(0.0, [Frame(frame.luma.copy()) for frame in frames])
    assert len(refinement._in_use) == before + 4
    alone = other.refine(frames[1].luma)
    np.testing.assert_array_equal(first.refine(frames[1].luma).luma, alone.luma)
    del first, other, alone
    assert len(refinement._in_use) == before + 2
    del second
    assert len(refinement._in_use) == before


def test_chroma_follows_the_offsets(frames: list[Frame]) -> None:
    """Chroma planes of half the size are predicted from both references; grey references give none."""
    refiner = refiner_with(0.0, frames)
    chroma = refiner.chroma()
    assert chroma is not None
    assert [plane.shape for plane in chroma] == [(16, 24), (16, 24)]
    assert set(np.unique(chroma[1])) == {141}
    zero = [np.zeros((8, 12, 2), np.int64)] * 2
    grey = [frame.without_chroma() for frame in frames[:2]]
    assert compensate_chroma(grey, zero, [np.ones((8, 12))] * 2, BLOCK) is None
