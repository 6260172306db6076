"""The model of the operations of estimates is what their kernels do, on numbers that count."""

from dataclasses import astuple

import numpy as np
import pytest

from dvc.wynerziv import transform
from encoder.one_way import _kernels, operations
from encoder.one_way.laplacian import NUM_PLACES, PER_PLANE, laplacian_tables
from encoder.one_way.needs import _FIRST, NEEDS
from encoder.one_way.sampled_blocks import _ROUNDING, BLOCK_PX, SPACING_PX, BlockSampler, OneWayWork
from encoder.operations import Operations
from tests.clips import moving_texture
from tests.counting import Data, Tally, counting

RNG = np.random.default_rng(3)
FRAMES = [frame.luma for frame in moving_texture(3, 64, 96)]
SAMPLER = BlockSampler((64, 96))
CORNERS, COUNT = SAMPLER._corners, SAMPLER.num_blocks


def test_nearest_points() -> None:
    """Every point is compared with every block; the nearest, which come first here, are kept in order."""
    tally, points = Tally(), np.array([[4.0 + k, 4.0] for k in range(100)])
    distances, nearest = np.empty((1, 3)), np.empty((1, 3), np.int64)
    given = Data(points, tally), CORNERS[:1], Data(distances, tally), nearest
    counting(_kernels.nearest_points, tally)(*given)
    found, model = tally.operations(), operations.nearest(len(points))
    assert nearest.tolist() == [[0, 1, 2]]
    assert (found.adds, found.multiplies) == (model.adds, model.multiplies)
    assert model.compares < found.compares < 1.1 * model.compares
    assert model.bytes < found.bytes < 1.1 * model.bytes


def test_moved_blocks() -> None:
    """Motion of three points, samples at half places, and noise that is added."""
    tally, motion = Tally(), np.zeros((COUNT, 2), np.int64)
    near = np.tile(np.arange(3), (COUNT, 1))
    given = (
        Data(RNG.uniform(0, 99, near.shape), tally),
        Data(near, tally),
        Data(RNG.normal(size=(3, 2)), tally),
    )
    counting(_kernels.blend_motion, tally)(*given, Data(motion, tally))
    blocks = Data(np.zeros((COUNT, BLOCK_PX, BLOCK_PX), np.int32), tally)
    counting(_kernels.add_half_samples, tally)(Data(FRAMES[0], tally), CORNERS, np.zeros_like(motion), blocks)
    noise = (Data(np.ones((transform.NUM_BANDS, COUNT)), tally) for _ in range(2))
    counting(_kernels.add_noise, tally)(CORNERS, np.zeros_like(motion), SAMPLER._grid, SPACING_PX, *noise)
    assert astuple(tally.operations()) == pytest.approx(astuple(operations.moved(COUNT)), rel=0.02)


def test_residuals() -> None:
    """Differences, their energies by bands, and where these stand in the tables."""
    tally, blocks = Tally(), Data(np.zeros((COUNT, BLOCK_PX, BLOCK_PX), np.int32), Tally())
    blocks.tally = tally
    counting(_kernels.subtract_samples, tally)(Data(FRAMES[1], tally), CORNERS, 8, blocks)
    energies = Data(np.zeros((transform.NUM_BANDS, COUNT)), tally)
    counting(_kernels.energies, tally)(blocks, 8.0, transform.SCALE, transform.ORDER, energies)
    places = Data(np.empty((transform.NUM_BANDS, COUNT), np.int64), tally)
    histograms = Data(np.zeros((transform.NUM_BANDS, NUM_PLACES), np.int64), tally)
    given = energies, energies, NEEDS[0].variance, 4.0, _FIRST, places, histograms
    counting(_kernels.variance_places, tally)(*given)
    tally["bytes"] -= histograms.array.nbytes  # the tables are cleared once for all blocks
    planes = np.full(transform.NUM_BANDS, 3)
    all_places = Data(np.full((transform.NUM_BANDS, COUNT), 40), tally)
    tables = tuple(Data(table, tally) for table in laplacian_tables())
    noise = Data(np.empty((transform.NUM_BANDS, COUNT)), tally)
    counting(_kernels.remaining_noise, tally)(all_places, planes, planes, 4.0, PER_PLANE, tables, noise)
    assert astuple(tally.operations()) == pytest.approx(astuple(operations.residual(COUNT)), rel=0.04)


def test_intra_noise() -> None:
    """Three directions of prediction, their transforms and errors."""
    tally, errors = Tally(), np.zeros((transform.NUM_BANDS, COUNT))
    given = CORNERS, 10.0, _ROUNDING, transform.SCALE, transform.ORDER, Data(errors, tally)
    counting(_kernels.intra_errors, tally)(Data(FRAMES[1], tally), *given)
    model = operations.intra_noise(COUNT)
    assert astuple(tally.operations()) == pytest.approx(astuple(model), rel=0.03)
    np.testing.assert_allclose(errors, SAMPLER.intra_noise(FRAMES[1], 10.0))


def test_estimates_add_up() -> None:
    """A run without blocks takes nothing."""
    assert operations.estimates(OneWayWork()) == Operations()
    work = OneWayWork(1, 2, 3, 4)
    parts = operations.residual(1), operations.moved(2), operations.intra_noise(3), operations.nearest(4)
    assert operations.estimates(work).adds == sum(part.adds for part in parts)
