"""What tracks leave to be told, on some blocks."""

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.wynerziv import transform
from encoder.rate_control import _kernels
from encoder.rate_control.sampled_blocks import BLOCK_PX, SPACING_PX, BlockSampler, overlapping_words
from tests.clips import moving_texture

SHAPE = (48, 64)
BLOCKS = 12
NONE = np.empty((0, 2, 2))


def points(displacement: tuple[float, float]) -> np.ndarray:
    """Return points of a frame, and where they are in a reference; shape (N, 2, 2)."""
    grid = np.stack(np.meshgrid(np.arange(5.0, 64, 12), np.arange(5.0, 48, 12)), axis=-1).reshape(-1, 2)
    return np.stack([grid, grid + displacement], axis=1)


def silence() -> np.ndarray:
    """Return the noise of a reference that has none."""
    return np.zeros((16, BLOCKS), np.float32)


def sampled(picture: np.ndarray) -> np.ndarray:
    """Return mean squared coefficients of the sampled blocks of a picture; shape (16, BLOCKS)."""
    squares = (transform.forward(picture) ** 2).reshape(16, 6, 2, 8, 2).mean(axis=(2, 4))
    spacing = SPACING_PX // BLOCK_PX
    return squares[:, ::spacing, ::spacing].reshape(16, -1)


def test_what_moves_with_the_points_leaves_nothing() -> None:
    """Inside the picture; without motion of the points, or without points, everything is left."""
    texture = np.random.default_rng(1).integers(0, 256, (80, 96), dtype=np.uint8)
    frame, reference = texture[10:58, 12:76], texture[7:55, 8:72]  # (x, y) is at (x + 4, y + 3) there
    sampler = BlockSampler(SHAPE)
    assert sampler.num_blocks == BLOCKS
    found = {}
    for name, places in (
        ("moved", points((4.0, 3.0))),
        ("still", points((0.0, 0.0))),
        ("none", NONE),
    ):
        found[name] = sampler.errors(
            overlapping_words(frame), [overlapping_words(reference)], [silence()], places
        )
    inner = np.arange(BLOCKS).reshape(3, 4)[:, :3].ravel()
    assert found["moved"].residual[:, inner].max() == 0.0
    assert found["still"].residual[:, inner].min() > 1.0
    np.testing.assert_array_equal(found["none"].residual, found["still"].residual)


def test_points_that_are_not_known_everywhere_do_not_count() -> None:
    """Neither in the frame nor in a reference."""
    frames = [overlapping_words(frame.luma) for frame in moving_texture(2, *SHAPE)]
    given = points((2.5, -1.0))
    expected = BlockSampler(SHAPE).errors(frames[1], frames[:1], [silence()], given[7:])
    given[:3, 0], given[3:7, 1] = np.nan, np.nan
    found = BlockSampler(SHAPE).errors(frames[1], frames[:1], [silence()], given)
    np.testing.assert_array_equal(found.residual, expected.residual)


def test_residuals_are_those_of_the_transform() -> None:
    """Mean squares by bands in blocks of 8x8 samples, of the mean of two references at rest."""
    frames = [frame.luma for frame in moving_texture(3, *SHAPE)]
    noises = [np.full((16, BLOCKS), of, np.float32) for of in (3.0, 5.0)]
    words = [*map(overlapping_words, frames)]
    found = BlockSampler(SHAPE).errors(words[1], words[::2], noises, np.empty((0, 3, 2)))
    mean = (frames[0].astype(np.float64) + frames[2]) / 2
    np.testing.assert_allclose(found.residual, sampled(frames[1] - mean), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.noise, 2.0)  # of the mean of two that are independent


def test_noise_comes_from_where_the_blocks_come_from() -> None:
    """From the sampled block that is nearest there, at the borders as well."""
    words = overlapping_words(np.zeros(SHAPE, np.uint8))
    noise = np.tile(np.arange(BLOCKS, dtype=np.float32), (16, 1))
    found = BlockSampler(SHAPE).errors(words, [words], [noise], points((16.0, -15.0)))
    rows, columns = np.divmod(np.arange(BLOCKS), 4)
    expected = 4 * np.maximum(rows - 1, 0) + np.minimum(columns + 1, 3)
    np.testing.assert_array_equal(found.noise, np.tile(expected, (16, 1)))


def test_intra_noise() -> None:
    """None of even pictures and of lossless ones; that of a uniform quantiser where there is much to code."""
    sampler = BlockSampler((288, 352))
    noisy = np.random.default_rng(2).integers(0, 256, (288, 352), dtype=np.uint8)
    assert sampler.intra_noise(np.full((288, 352), 90, np.uint8), 16.0).max() == 0.0
    assert sampler.intra_noise(noisy, 0.0).max() == 0.0
    fine = sampler.intra_noise(noisy, 16.0)
    assert fine.mean() == pytest.approx(16.0**2 * (1 / 3**3 + (2 / 3) ** 3) / 3, rel=0.05)
    coarse = sampler.intra_noise(noisy, 4000.0)
    assert coarse.mean() == pytest.approx(255.0**2 / 12, rel=0.4)  # everything is lost


@pytest.mark.parametrize("shape", [(7, 64), (1, 1), (23, 41), (8, 8)])
def test_blocks_that_are_not_whole_are_left_out(shape: tuple[int, int]) -> None:
    """Small pictures have none."""
    sampler = BlockSampler(shape)
    luma = np.zeros(shape, np.uint8)
    expected = len(range(0, shape[0] - 7, 16)) * len(range(0, shape[1] - 7, 16))
    assert sampler.num_blocks == expected
    assert sampler.intra_noise(luma, 8.0).shape == (16, expected)
    words = overlapping_words(luma)
    found = sampler.errors(words, [words], [np.zeros((16, expected), np.float32)], NONE)
    assert found.residual.shape == (16, expected)


@pytest.mark.nojit
def test_words_at_borders_repeat_them() -> None:
    """From any place on, as of a picture with a border around it."""
    image = np.random.default_rng(6).integers(0, 256, (9, 11), dtype=np.uint8)
    padded, words = np.pad(image, 20, mode="edge"), overlapping_words(image)
    for y in range(-3, 13):
        for x in range(-12, 23):
            word = np.uint64(python_twin(_kernels.word_at)(words, y, x))
            assert word.tobytes() == padded[20 + y, 20 + x : 28 + x].tobytes()


@pytest.mark.nojit
def test_kernels_are_their_python() -> None:
    """To the last bit."""
    rng = np.random.default_rng(5)
    image = rng.integers(0, 256, (24, 40), dtype=np.uint8)
    grid, corners = (2, 3), np.array([[0, 0], [0, 16], [0, 32], [16, 0], [16, 16], [16, 32]])
    motion = np.array([[1, -3], [40, 7], [-9, 2], [3, 200], [-5, -5], [3, 1]])
    spots = rng.uniform(0.0, 40.0, (7, 2, 2))
    near = rng.integers(0, 1 << 20, (2, 3, 8)).astype(np.int32)
    near[0, 2] = _kernels.FAR
    noise = rng.uniform(0.0, 9.0, (16, 6))
    lines = ((2, 8, 24), np.int16)
    calls = [
        (_kernels.nearest_points, (spots, _kernels.Sampling(grid, 16, 100.0, 3)), ((2, 3, 8), np.int32)),
        (_kernels.blend_motion, (spots % 7, 1, grid, 16, 2, near), ((6, 2), np.int64)),
        (_kernels.cut_blocks, (overlapping_words(image), grid, 16, 8), lines),
        (_kernels.subtract_moved, (overlapping_words(image), motion, grid, 16), lines),
        (
            _kernels.intra_errors,
            (image, corners, 20.0, 0.3, transform.SCALE, transform.ORDER),
            ((16, 6), np.float64),
        ),
        (_kernels.add_noise, (motion, grid, 16, 0.5, noise), ((16, 6), np.float64)),
    ]
    for kernel, given, *outputs in calls:
        found = []
        for function in (kernel, python_twin(kernel)):
            arrays = [np.zeros(shape, kind) for shape, kind in outputs]
            function(*given, *arrays)
            found.append(arrays)
        for ours, twins in zip(*found, strict=True):
            np.testing.assert_array_equal(ours, twins, err_msg=str(kernel))
            assert ours.any(), kernel
    blocks = rng.integers(-2000, 2000, (2, 8, 24)).astype(np.int16)
    means, twins = np.zeros((2, 16, 6))
    _kernels.energies(blocks.copy(), grid, transform.SCALE, transform.ORDER, 0.5, means)
    python_twin(_kernels.energies)(blocks, grid, transform.SCALE, transform.ORDER, 0.5, twins)
    np.testing.assert_array_equal(means, twins)
    assert means.all()


def test_nearest_points_are_the_nearest() -> None:
    """Of any points, as by all distances; in the order of these."""
    rng, grid, bits = np.random.default_rng(7), (6, 9), 9
    centres = 16.0 * np.stack(np.meshgrid(*map(np.arange, grid), indexing="ij"), axis=-1).reshape(-1, 2) + 4.0
    for count in (0, 2, 3, 40, 300):
        spots = rng.uniform(0.0, 1.0, (count, 1, 2)) ** 2 * (144, 96)
        keys = np.empty((6, 3, 16), np.int32)
        sampling = _kernels.Sampling(grid, 16, 2**20 / (96**2 + 144**2), bits)
        compared = _kernels.nearest_points(spots, sampling, keys)
        assert compared <= count * len(centres) if count < 300 else compared < 0.7 * count * len(centres)
        keys = keys[:, :, : grid[1]].transpose(0, 2, 1).reshape(len(centres), -1)
        places, kept = keys & ((1 << bits) - 1), min(count, 3)
        assert (keys[:, kept:] == _kernels.FAR).all()
        squares = ((spots[None, :, 0, ::-1] - centres[:, None]) ** 2).sum(axis=2)
        found = np.take_along_axis(squares, places[:, :kept].astype(np.int64), axis=1)
        np.testing.assert_allclose(found, np.sort(squares, axis=1)[:, :kept], atol=0.1)


def test_large_pictures_have_about_as_many_blocks() -> None:
    """One block in four of small ones; of others, blocks that are farther apart."""
    small, large, huge = (BlockSampler(shape).num_blocks for shape in ((288, 352), (720, 1280), (2160, 3840)))
    assert small == 18 * 22
    assert 700 < large < 1100
    assert 700 < huge < 1100
