"""The 4x4 transform against one matrix product per block."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.wynerziv import transform
from tests.reference import wynerziv as reference
from tests.twins import Choose


def random_luma(height: int, width: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)


def test_transforms_equal_matrix_products() -> None:
    """Bands are the products of every block with the orthonormal basis, in zigzag order; and back."""
    bands = np.random.default_rng(1).normal(0.0, 50.0, (16, 5, 7))
    np.testing.assert_allclose(transform.inverse(bands, 20, 28), reference.inverse(bands), atol=1e-9)
    luma = random_luma(24, 36)
    np.testing.assert_allclose(transform.forward(luma), reference.forward(luma), atol=1e-9)
    np.testing.assert_allclose(transform.forward(luma / 7.0), reference.forward(luma) / 7.0, atol=1e-9)


@given(st.integers(1, 21), st.integers(1, 21), st.integers(0, 2**32 - 1))
def test_round_trip_restores_every_sample(height: int, width: int, seed: int) -> None:
    luma = random_luma(height, width, seed)
    bands = transform.forward(luma)
    assert bands.shape == (16, *transform.band_shape(height, width))
    np.testing.assert_array_equal(transform.to_uint8(transform.inverse(bands, height, width)), luma)


def test_transform_is_orthonormal() -> None:
    """Energy is the same in samples and coefficients; white has a DC coefficient of 1020 and nothing else."""
    luma = random_luma(16, 16).astype(np.float64)
    assert np.sum(transform.forward(luma) ** 2) == pytest.approx(np.sum(luma**2))
    bands = transform.forward(np.full((8, 8), 255, np.uint8))
    np.testing.assert_array_equal(bands[0], np.full((2, 2), 1020.0))
    np.testing.assert_array_equal(bands[1:], 0.0)


def test_padding_replicates_the_border() -> None:
    luma = random_luma(6, 9)
    padded = np.pad(luma, ((0, 2), (0, 3)), mode="edge")
    np.testing.assert_array_equal(transform.forward(luma), transform.forward(padded))
    assert transform.pad_to_blocks(padded) is padded


@given(st.integers(1, 21), st.integers(1, 21), st.integers(0, 2**32 - 1))
def test_core_times_scale_is_the_transform(height: int, width: int, seed: int) -> None:
    """The integer core gives the same numbers to the last digit, for frames of any size."""
    luma = random_luma(height, width, seed)
    core, extremes = transform.integer_core(luma)
    bands = transform.forward(luma).reshape(16, -1)
    np.testing.assert_array_equal(core * transform.BAND_SCALE[:, None], bands)
    np.testing.assert_array_equal(extremes, np.stack([core.min(axis=1), core.max(axis=1)], axis=1))


def test_core_takes_samples_wherever_they_lie() -> None:
    """Parts of frames, at addresses of any kind, and frames that cannot be written to are the same."""
    frame = random_luma(21, 40)
    for part in (frame[3:15, 5:25], frame[::-1, ::-1], frame.ravel()[1:801].reshape(20, 40)):
        read_only = part.copy()
        read_only.flags.writeable = False
        expected = transform.integer_core(part.copy())
        for luma in (part, read_only):
            for got, wanted in zip(transform.integer_core(luma), expected, strict=True):
                np.testing.assert_array_equal(got, wanted)


def test_core_refuses_other_samples() -> None:
    with pytest.raises(TypeError, match="uint8"):
        transform.integer_core(np.zeros((8, 8), np.int64))  # type: ignore[arg-type]


def largest_blocks() -> np.ndarray:
    """Return a row of blocks in which each coefficient is as small or as large as 8-bit samples make it."""
    patterns = np.einsum("yi,xj->yxij", reference.CORE, reference.CORE).reshape(16, 4, 4)
    return np.hstack([255 * (sign * pattern > 0) for sign in (1, -1) for pattern in patterns]).astype(
        np.uint8
    )


@pytest.mark.nojit
def test_core_kernel_equals_matrix_products(choose: Choose) -> None:
    """Compiled and as Python, the kernel gives the core, and the extremes of each band, up to the largest."""
    luma = np.vstack([largest_blocks(), random_luma(8, 128)])
    core, extremes = np.empty((16, 96), np.int16), np.empty((16, 2), np.int16)
    run = choose(transform._transform_samples)
    rank = np.array(reference.ZIGZAG_RANK)
    run(luma.view("<u4"), rank, core, extremes)
    blocks = luma.reshape(3, 4, 32, 4).transpose(0, 2, 1, 3).reshape(96, 4, 4).astype(int)
    expected = np.empty((16, 96), int)
    expected[rank.ravel()] = (reference.CORE @ blocks @ reference.CORE.T).reshape(96, 16).T
    np.testing.assert_array_equal(core, expected)
    np.testing.assert_array_equal(extremes, np.stack([expected.min(axis=1), expected.max(axis=1)], axis=1))
    assert extremes[0].tolist() == [0, 4080]
    assert extremes.max() == 4590


@pytest.mark.nojit
def test_kernel_equals_matrix_products(choose: Choose) -> None:
    luma = random_luma(12, 20).astype(np.float64)
    bands = np.empty((16, 15))
    run = choose(transform._transform_blocks)
    run(luma, transform.SCALE, np.array(reference.ZIGZAG_RANK), bands)
    np.testing.assert_allclose(bands.reshape(16, 3, 5), reference.forward(luma), atol=1e-9)


def test_inverse_refuses_bands_of_another_frame() -> None:
    with pytest.raises(ValueError, match="does not fit a frame of 8x8"):
        transform.inverse(np.zeros((16, 1, 2)), 8, 8)


def test_to_uint8_rounds_halves_up_and_clips() -> None:
    samples = np.array([-3.0, -0.5, 0.49, 0.5, 1.5, 254.5, 300.0])
    assert transform.to_uint8(samples).tolist() == [0, 0, 0, 1, 2, 255, 255]
