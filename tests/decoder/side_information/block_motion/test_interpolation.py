"""Block motion on textures that move by known amounts."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decoder.side_information.block_motion.interpolation import (
    BlockMotionInterpolation,
    estimate_motion,
    split_field,
    vector_median,
)
from decoder.side_information.protocol import ReferenceFrame
from dvc.metrics import psnr_db
from dvc.wynerziv.transform import to_uint8
from tests.clips import moving_texture


@pytest.mark.parametrize("motion_px", [(0.0, 0.0), (1.0, -2.0), (0.5, 1.25), (-2.0, 3.0)])
def test_translation_is_recovered(motion_px: tuple[float, float]) -> None:
    """Nearly all blocks of a translated texture get its displacement, to a quarter sample."""
    frames = moving_texture(3, 64, 80, motion_px)
    field = estimate_motion(frames[0].luma, frames[2].luma, Fraction(1, 2))
    expected = np.round(8.0 * np.array(motion_px))
    error = np.abs(field[1:-1, 1:-1] - expected).max(axis=-1)
    assert (error <= 1).mean() > 0.95


@pytest.mark.parametrize(("instant", "min_psnr_db"), [(1, 38.0), (2, 38.0), (3, 38.0)])
def test_prediction_resembles_the_missing_frame(instant: int, min_psnr_db: float) -> None:
    """Away from the border, any instant between the references is predicted well."""
    frames = moving_texture(5, 64, 80, (0.75, -1.5))
    references = [ReferenceFrame(index, frames[index]) for index in (0, 4)]
    [prediction] = BlockMotionInterpolation().predict(references, None, [instant])
    inside = np.s_[12:-12, 12:-12]
    assert psnr_db(to_uint8(prediction.luma)[inside], frames[instant].luma[inside]) > min_psnr_db
    assert prediction.chroma is not None


def test_closest_references_are_used() -> None:
    """Of many references, the two around the instant serve it."""
    frames = moving_texture(5, 16, 24)
    many = [ReferenceFrame(index, frames[index]) for index in (0, 1, 3, 4)]
    method = BlockMotionInterpolation()
    [wide], [narrow] = method.predict(many, None, [2]), method.predict(many[1:3], None, [2])
    np.testing.assert_array_equal(wide.luma, narrow.luma)


@given(
    st.lists(st.integers(-200, 200), min_size=2, max_size=2), st.integers(1, 9), st.integers(2, 10)
)  # fmt: skip
def test_split_field_lies_on_the_trajectory(vector: list[int], numerator: int, denominator: int) -> None:
    """Both offsets differ by the displacement, and lie within half a step of their share of it."""
    numerator = min(numerator, denominator - 1)
    field = np.array(vector).reshape(1, 1, 2)
    to_before, to_after = split_field(field, Fraction(numerator, denominator))
    np.testing.assert_array_equal(to_after - to_before, field)
    np.testing.assert_allclose(to_before, -field * numerator / denominator, atol=0.5)


def test_vector_median_drops_outliers_and_keeps_edges() -> None:
    """A lonely vector gives way to its surroundings; a border between two motions stays."""
    field = np.zeros((6, 8, 2), np.int64)
    field[:, 4:] = (8, -4)
    noisy = field.copy()
    noisy[2, 1] = (90, 90)
    np.testing.assert_array_equal(vector_median(noisy), field)


def test_vector_median_keeps_the_vector_on_ties() -> None:
    """A field of two vectors has nothing to choose by."""
    field = np.array([[[0, 0], [5, 5]]])
    np.testing.assert_array_equal(vector_median(np.full((1, 1, 2), 7)), [[[7, 7]]])
    assert vector_median(field).shape == field.shape
