"""Tables of Laplacians in bins."""

import numpy as np
import pytest

from encoder.rate_control.laplacian import FIRST_OCTAVE, NUM_PLACES, PER_OCTAVE, laplacian_tables


def test_wide_distributions_fill_their_bins_evenly() -> None:
    """The error that is left is a twelfth of the squared width."""
    variance, error = laplacian_tables()
    assert len(variance) == len(error) == NUM_PLACES
    wide = slice(-FIRST_OCTAVE * PER_OCTAVE + 4 * PER_OCTAVE, None)
    np.testing.assert_allclose((variance * error)[wide], 1 / 12, rtol=0.05)


def test_narrow_distributions_gain_nothing() -> None:
    """All in one bin but for those at a border."""
    _, error = laplacian_tables()
    assert error[0] > 0.95
    assert (np.diff(error) < 0).all()


@pytest.mark.parametrize("octave", [-3, 0, 3])
def test_tables_are_what_samples_show(octave: int) -> None:
    """Bins of width 1 at random offsets, against drawn Laplacians."""
    variance, error = laplacian_tables()
    place = PER_OCTAVE * (octave - FIRST_OCTAVE) + 3
    rng = np.random.default_rng(octave + 10)
    squares = []
    for offset in (np.arange(16) + 0.5) / 16:
        drawn = rng.laplace(0.0, np.sqrt(variance[place] / 2), 40000)
        _, bins, counts = np.unique(np.floor(drawn + offset), return_inverse=True, return_counts=True)
        squares.append(((drawn - (np.bincount(bins, drawn) / counts)[bins]) ** 2).mean())
    assert error[place] == pytest.approx(np.mean(squares) / variance[place], rel=0.05)
