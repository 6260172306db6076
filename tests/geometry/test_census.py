"""Census bits, compiled and as Python, against their definitions."""

import numpy as np
import pytest

from dvc.geometry import _kernels as kernels
from tests.reference import cost_volumes as reference
from tests.twins import Choose

SHAPE = (7, 9)


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a fresh generator."""
    return np.random.default_rng(5)


@pytest.mark.nojit
@pytest.mark.parametrize("radius", [1, 2])
def test_census_bits(choose: Choose, rng: np.random.Generator, radius: int) -> None:
    """Neighbours that are darker by more than the dead zone, row by row; the border repeats."""
    grey = rng.integers(0, 12, SHAPE).astype(np.float32)
    bits = np.empty(SHAPE, np.uint32)
    choose(kernels.census)(np.pad(grey, radius, mode="edge"), radius, np.float32(2.0), bits)
    expected = reference.census(grey.astype(np.float64), radius, 2.0)
    length = (2 * radius + 1) ** 2 - 1
    np.testing.assert_array_equal(np.vectorize(lambda word: f"{word:0{length}b}")(bits), expected)


@pytest.mark.nojit
def test_bits_are_counted(choose: Choose, rng: np.random.Generator) -> None:
    """All words of 64 bits, with none and with all of them set."""
    words = [0, 1, 1 << 63, (1 << 64) - 1, *rng.integers(0, 1 << 64, 50, np.uint64).tolist()]
    with np.errstate(over="ignore"):  # the product wraps around on purpose
        found = [int(choose(kernels.count_bits)(np.uint64(word))) for word in words]
    assert found == [word.bit_count() for word in words]
