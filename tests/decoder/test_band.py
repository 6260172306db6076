"""A band while it is decoded: intervals halve where bits are known, and only there."""

import numpy as np
import pytest

from decoder.band import Band
from dvc.wynerziv import quantizer

SHAPE = (6, 8)
STEP, PLANES = 8.0, 5


@pytest.fixture
def band() -> Band:
    """Return a band of which nothing is known, predicted with some noise."""
    rng = np.random.default_rng(1)
    count = SHAPE[0] * SHAPE[1]
    edges = quantizer.embedded_edges(1, PLANES, STEP)
    prefix = np.zeros(count, np.int64)
    lower, upper = quantizer.prefix_borders(prefix, PLANES, edges)
    return Band(
        1, PLANES, 7, edges, rng.normal(0.0, 20.0, count), np.full(count, 3.0), 1.3, 1.3, SHAPE,
        prefix, np.zeros(count, np.int64), np.arange(count), lower, upper,
    )  # fmt: skip


def bits_of(band: Band, truth: np.ndarray, missing: int) -> np.ndarray:
    """Return a plane of values."""
    origin = quantizer.embedded_origin(1, PLANES)
    bins = np.clip(np.floor(truth / STEP + origin), 0, 2**PLANES - 1).astype(np.int64)
    found: np.ndarray = (bins >> missing & 1).astype(np.uint8)
    return found


def test_intervals_close_in_on_values(band: Band) -> None:
    """With every plane they are half as wide and still hold the value, in chosen blocks alone."""
    rng = np.random.default_rng(2)
    truth = band.predicted + rng.laplace(0.0, 4.0, band.predicted.size)
    width = band.upper - band.lower
    blocks = np.arange(truth.size)
    for missing in reversed(range(PLANES)):
        blocks = blocks[rng.random(blocks.size) < 0.8]
        assert band.place(missing) == (1, PLANES - missing - 1)
        band.take(blocks, bits_of(band, truth, missing)[blocks], missing)
        width[blocks] /= 2
        np.testing.assert_allclose(band.upper - band.lower, width)
        assert (band.lower <= truth)[blocks].all()
        assert (truth < band.upper)[blocks].all()
        np.testing.assert_array_equal(band.open, blocks)
    assert band.num_taken == PLANES


def test_what_bits_take_off_is_what_means_move(band: Band) -> None:
    """The squared change of the conditional mean; nothing where the prediction was sure and right."""
    truth = np.where(np.arange(band.predicted.size) < 10, band.predicted + 90.0, band.predicted)
    before = band.known.reconstruct(band.predicted.reshape(SHAPE))
    gain = band.gain
    saved = band.take(np.arange(truth.size), bits_of(band, truth, PLANES - 1), PLANES - 1)
    band.gain = gain
    after = band.known.reconstruct(band.predicted.reshape(SHAPE))
    assert saved == pytest.approx(np.sum((after - before) ** 2))
    assert saved > 0.0


def test_scales_are_fitted_to_what_is_known(band: Band) -> None:
    """Values far from their predictions raise the factor on the scales."""
    truth = band.predicted + 25.0 * (-1.0) ** np.arange(band.predicted.size)
    for missing in reversed(range(PLANES)):
        band.take(np.arange(truth.size), bits_of(band, truth, missing), missing)
    assert band.gain > 3.0


def test_planes_that_are_entered_again_replace_wrong_ones(band: Band) -> None:
    """As if they had been right at once."""
    rng = np.random.default_rng(3)
    truth = band.predicted + rng.laplace(0.0, 9.0, band.predicted.size)
    taken = []
    for missing in reversed(range(PLANES)):
        blocks = band.open[rng.random(band.open.size) < 0.9]
        bits = bits_of(band, truth, missing)[blocks]
        taken.append((blocks, bits))
        wrong = bits.copy()
        wrong[0] ^= missing == 2
        band.take(blocks, wrong, missing)
    wrong_lower = band.lower.copy()
    band.forget()
    np.testing.assert_array_equal(band.upper - band.lower, STEP * 2**PLANES)
    for blocks, bits in taken:
        band.enter(blocks, bits)
    assert (band.lower != wrong_lower).any()
    known = band.depth == PLANES
    assert known.sum() > 20
    assert ((band.lower <= truth) & (truth < band.upper))[known].all()
