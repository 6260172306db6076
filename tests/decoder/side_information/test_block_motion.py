"""Block motion on textures that move by known amounts."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decoder.side_information import block_motion
from decoder.side_information.block_motion import (
    BLOCK,
    BlockMotionInterpolation,
    BlockRefiner,
    compensate_chroma,
    estimate_motion,
    split_field,
)
from decoder.side_information.protocol import ReferenceFrame
from dvc.metrics import psnr_db
from dvc.video import Frame
from dvc.wynerziv.transform import to_uint8
from tests.clips import moving_texture
from tests.reference.block_motion import sample_at


@pytest.mark.parametrize("motion_px", [(0.0, 0.0), (1.0, -2.0), (0.5, 1.25), (-2.0, 3.0)])
def test_translation_is_recovered(motion_px: tuple[float, float]) -> None:
    frames = moving_texture(3, 64, 80, motion_px)
    field = estimate_motion(frames[0].luma, frames[2].luma, Fraction(1, 2))
    expected = np.round(8.0 * np.array(motion_px))
    error = np.abs(field[1:-1, 1:-1] - expected).max(axis=-1)
    assert (error <= 1).mean() > 0.95


@pytest.mark.parametrize("instant", [1, 2, 3])
def test_prediction_resembles_the_missing_frame(instant: int) -> None:
    frames = moving_texture(5, 64, 80, (0.75, -1.5))
    references = [ReferenceFrame(index, frames[index]) for index in (0, 4)]
    [prediction] = BlockMotionInterpolation().predict(references, None, [instant])
    inside = np.s_[12:-12, 12:-12]
    assert psnr_db(to_uint8(prediction.luma)[inside], frames[instant].luma[inside]) > 38.0
    assert prediction.chroma is not None


def test_closest_references_are_used() -> None:
    frames = moving_texture(5, 16, 24)
    many = [ReferenceFrame(index, frames[index]) for index in (0, 1, 3, 4)]
    method = BlockMotionInterpolation()
    [wide], [narrow] = method.predict(many, None, [2]), method.predict(many[1:3], None, [2])
    np.testing.assert_array_equal(wide.luma, narrow.luma)


@given(
    st.lists(st.integers(-200, 200), min_size=2, max_size=2), st.integers(1, 9), st.integers(2, 10)
)  # fmt: skip
def test_split_field_lies_on_the_trajectory(vector: list[int], numerator: int, denominator: int) -> None:
    numerator = min(numerator, denominator - 1)
    field = np.array(vector).reshape(1, 1, 2)
    to_before, to_after = split_field(field, Fraction(numerator, denominator))
    np.testing.assert_array_equal(to_after - to_before, field)
    np.testing.assert_allclose(to_before, -field * numerator / denominator, atol=0.5)


@pytest.fixture(scope="module")
def luma() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (9, 13), dtype=np.uint8)


def test_phase_planes_are_interpolated(luma: np.ndarray) -> None:
    margin = 5
    phases = block_motion.phase_planes(luma, margin)
    assert phases.shape == (4, 4, 9 + 2 * margin, 13 + 2 * margin)
    rng = np.random.default_rng(1)
    for row, column in rng.integers(
        (-4 * margin, -4 * margin), (4 * (9 + margin), 4 * (13 + margin)), (400, 2)
    ):
        got = phases[row % 4, column % 4, row // 4 + margin, column // 4 + margin]
        assert got == sample_at(luma, row, column), (row, column)


def test_low_pass_is_the_mean_of_nine(luma: np.ndarray) -> None:
    padded = np.pad(luma.astype(int), 1, mode="edge")
    expected = [[(padded[y : y + 3, x : x + 3].sum() + 4) // 9 for x in range(13)] for y in range(9)]
    np.testing.assert_array_equal(block_motion.low_pass(luma), expected)


def test_halve_is_the_mean_of_four(luma: np.ndarray) -> None:
    padded = np.pad(luma.astype(int), ((0, 1), (0, 1)), mode="edge")
    expected = [
        [(padded[y : y + 2, x : x + 2].sum() + 2) // 4 for x in range(0, 14, 2)] for y in range(0, 10, 2)
    ]
    np.testing.assert_array_equal(block_motion.halve(luma), expected)


@pytest.mark.parametrize("block", [2, 4, 8, 16])
def test_compensation_without_motion_is_the_reference(block: int) -> None:
    lumas = [frame.luma for frame in moving_texture(2, 17, 23)]
    rows, columns = -(-17 // block), -(-23 // block)
    offsets = [np.zeros((rows, columns, 2), np.int64)] * 2
    weights = [np.full((rows, columns), share) for share in (0.25, 0.75)]
    phases = [block_motion.phase_planes(luma) for luma in lumas]
    prediction, compensated = block_motion.compensate(phases, offsets, weights, block, (17, 23))
    for luma, own in zip(lumas, compensated, strict=True):
        np.testing.assert_allclose(own, luma)
    np.testing.assert_allclose(prediction, 0.25 * lumas[0] + 0.75 * lumas[1])


def test_compensation_follows_offsets() -> None:
    luma = moving_texture(1, 16, 24)[0].luma
    offsets = np.broadcast_to(np.array([4 * 2, 4 * -3]), (2, 3, 2)).copy()
    _, [moved] = block_motion.compensate(
        [block_motion.phase_planes(luma)], [offsets], [np.ones((2, 3))], 8, (16, 24)
    )
    rows, columns = np.clip(np.arange(16) + 2, 0, 15), np.clip(np.arange(24) - 3, 0, 23)
    np.testing.assert_allclose(moved, luma[rows][:, columns])


def test_resize_field_repeats_vectors() -> None:
    field = np.arange(8).reshape(2, 2, 2)
    fine = block_motion.resize_field(field, 5, 3, 2)
    assert fine[:, :, 0].tolist() == [[0, 0, 2], [0, 0, 2], [4, 4, 6], [4, 4, 6], [4, 4, 6]]


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
    spoilt = np.full_like(frames[0].luma, 16)
    shape = (32 // BLOCK, 48 // BLOCK, 2)
    offsets = [np.zeros(shape, np.int64), np.zeros(shape, np.int64)]
    refiner = BlockRefiner([Frame(spoilt), Frame(frames[1].luma)], offsets, "test")
    prediction = refiner.refine(frames[1].luma)
    assert psnr_db(to_uint8(prediction.luma), frames[1].luma) > 30


def test_references_are_held_once(frames: list[Frame]) -> None:
    """Frames that are decoded side by side share what is made of their references while one needs it."""
    before = len(block_motion._in_use)
    first, second = refiner_with(0.0, frames), refiner_with(1.0, frames)
    other = refiner_with(0.0, [Frame(frame.luma.copy()) for frame in frames])
    assert len(block_motion._in_use) == before + 4
    alone = other.refine(frames[1].luma)
    np.testing.assert_array_equal(first.refine(frames[1].luma).luma, alone.luma)
    del first, other, alone
    assert len(block_motion._in_use) == before + 2
    del second
    assert len(block_motion._in_use) == before


def test_chroma_follows_the_offsets(frames: list[Frame]) -> None:
    refiner = refiner_with(0.0, frames)
    chroma = refiner.chroma()
    assert chroma is not None
    assert [plane.shape for plane in chroma] == [(16, 24), (16, 24)]
    assert set(np.unique(chroma[1])) == {141}
    zero = [np.zeros((8, 12, 2), np.int64)] * 2
    grey = [frame.without_chroma() for frame in frames[:2]]
    assert compensate_chroma(grey, zero, [np.ones((8, 12))] * 2, BLOCK) is None
