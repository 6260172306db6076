"""The model of the operations of estimates is what their kernels do, on numbers that count."""

from dataclasses import astuple

import numpy as np
import pytest

from dvc.wynerziv import transform
from encoder.operations import Operations
from encoder.rate_control import _kernels, operations
from encoder.rate_control.laplacian import NUM_PLACES, PER_PLANE
from encoder.rate_control.needs import _FIRST, NEEDS, _cost_model
from encoder.rate_control.sampled_blocks import (
    _ROUNDING,
    _WEIGHTS,
    BLOCK_PX,
    SPACING_PX,
    BlockSampler,
    RateControlWork,
    overlapping_words,
)
from tests.clips import moving_texture
from tests.counting import Data, Tally, counting

RNG = np.random.default_rng(3)
FRAMES = [frame.luma for frame in moving_texture(3, 64, 96)]
SAMPLER = BlockSampler((64, 96))
CORNERS, COUNT = SAMPLER._corners, SAMPLER.num_blocks


def no_lines() -> np.ndarray:
    """Return room for the blocks."""
    return np.zeros((SAMPLER._grid[0], BLOCK_PX, BLOCK_PX * SAMPLER._grid[1]), np.int16)


def test_nearest_points() -> None:
    """A point is compared with all blocks of a row."""
    tally, columns = Tally(), 24
    across = RNG.integers(0, 1 << 20, columns).astype(np.int32)
    near = np.full((_kernels.NEAREST, columns), _kernels.FAR)
    counting(_kernels.compare_row, tally)(Data(across, tally), 5, Data(near, tally))
    assert tally.operations() == operations.nearest(columns)
    assert (near[0] == across + 5).all()


def test_moved_blocks() -> None:
    """Motion of three points, samples at half places, and noise that is added."""
    tally, motion, grid = Tally(), np.zeros((COUNT, 2), np.int64), SAMPLER._grid
    positions, bits = RNG.uniform(0, 64, (8, 2, 2)), 3
    keys = np.empty((grid[0], _kernels.NEAREST, 8), np.int32)
    _kernels.nearest_points(positions, _kernels.Sampling(grid, SPACING_PX, 1e4, bits), keys)
    given = 1, grid, SPACING_PX, bits, Data(keys, tally), Data(motion, tally)
    counting(_kernels.blend_motion, tally)(Data(positions, tally), *given)
    still, words = np.zeros_like(motion), Data(overlapping_words(FRAMES[0]), tally)
    given = words, Data(still, tally), grid, SPACING_PX, Data(no_lines(), tally)
    counting(_kernels.subtract_moved, tally)(*given)
    noise = (Data(np.ones((transform.NUM_BANDS, COUNT), np.float32), tally) for _ in range(2))
    counting(_kernels.add_noise, tally)(Data(still, tally), grid, SPACING_PX, 1.0, *noise)
    assert astuple(tally.operations()) == pytest.approx(astuple(operations.moved(COUNT)), rel=0.02)


def test_residuals() -> None:
    """Differences, their energies by bands, and where these stand in the tables."""
    tally, grid = Tally(), SAMPLER._grid
    words, counted = Data(overlapping_words(FRAMES[1]), tally), Data(no_lines(), tally)
    counting(_kernels.cut_blocks, tally)(words, grid, SPACING_PX, 4, counted)
    energies = Data(np.zeros((transform.NUM_BANDS, COUNT), np.float32), tally)
    counting(_kernels.energies, tally)(counted, grid, _WEIGHTS, transform.ORDER, 0.25, energies)
    places = Data(np.empty((transform.NUM_BANDS, COUNT), np.int16), tally)
    histograms = Data(np.zeros((transform.NUM_BANDS, NUM_PLACES), np.int64), tally)
    given = energies, energies, NEEDS[0].variance, 4.0, _FIRST, places, histograms
    counting(_kernels.variance_places, tally)(*given)
    tally["bytes"] -= histograms.array.nbytes  # the tables are cleared once for all blocks
    planes = np.full(transform.NUM_BANDS, 3)
    all_places = Data(np.full((transform.NUM_BANDS, COUNT), 40, np.int16), tally)
    noise = Data(np.empty((transform.NUM_BANDS, COUNT), np.float32), tally)
    given = planes, planes, 4.0, PER_PLANE, Data(_cost_model().tables, tally), noise
    counting(_kernels.remaining_noise, tally)(all_places, *given)
    assert astuple(tally.operations()) == pytest.approx(astuple(operations.residual(COUNT)), rel=0.04)


def test_intra_noise() -> None:
    """Three directions of prediction, their transforms and errors."""
    tally, errors = Tally(), np.zeros((transform.NUM_BANDS, COUNT))
    given = CORNERS, 10.0, _ROUNDING, transform.SCALE, transform.ORDER, Data(errors, tally)
    counting(_kernels.intra_errors, tally)(Data(FRAMES[1], tally), *given)
    *counted, num_bytes = astuple(tally.operations())
    *expected, expected_bytes = astuple(operations.intra_noise(COUNT))
    assert counted == expected
    assert num_bytes == pytest.approx(expected_bytes, rel=0.005)
    np.testing.assert_allclose(errors, SAMPLER.intra_noise(FRAMES[1], 10.0))


def test_estimates_add_up() -> None:
    """A run without blocks takes nothing."""
    assert operations.estimates(RateControlWork()) == Operations()
    work = RateControlWork(1, 2, 3, 4)
    parts = operations.residual(1), operations.moved(2), operations.intra_noise(3), operations.nearest(4)
    assert operations.estimates(work).adds == sum(part.adds for part in parts)
