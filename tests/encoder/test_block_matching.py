"""Searches for a block against their plain twins."""

import numpy as np
import pytest

from dvc._jit import python_twin
from encoder import _kernels
from encoder.block_matching import spiral
from tests.clips import moving_texture
from tests.reference import block_matching as reference

STILL_LIFE = moving_texture(1, 120, 160)[0].luma


def test_spiral_starts_at_rest_and_grows() -> None:
    """Each displacement of the square is there once, small ones first."""
    displacements = spiral(3)
    assert displacements[0].tolist() == [0, 0]
    assert len({tuple(d) for d in displacements.tolist()}) == 49
    assert (np.diff(np.hypot(*displacements.T)) >= -1e-12).all()


@pytest.mark.parametrize("twin", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_searches_agree_with_the_twin(seed: int, twin: bool) -> None:
    """Spiral and descent find what exhaustive comparisons find, in no more operations."""
    choose = python_twin if twin else (lambda kernel: kernel)
    rng = np.random.default_rng(seed)
    image = STILL_LIFE[:40, :48]
    for _ in range(15):
        x, y = (int(c) for c in rng.integers(2, [46, 38]))
        block = STILL_LIFE[40:45, 60:65] if rng.random() < 0.3 else image[y - 2 : y + 3, x - 2 : x + 3]
        if block.shape != (5, 5):
            continue
        block = np.ascontiguousarray(block)
        at = x + int(rng.integers(-4, 5)), y + int(rng.integers(-4, 5))
        counts = np.zeros(2, np.int64)
        small = int(rng.integers(0, 200))
        found = choose(_kernels.spiral_search)(image, *at, 2, block, small, spiral(4), counts)
        expected = reference.spiral_search(image, *at, block, small, spiral(4))
        assert found == (expected if expected[2] is not None else (*expected[:2], _kernels.UNKNOWN))
        assert counts[0] <= 81
        if expected[2] is None:
            continue
        went = choose(_kernels.descend)(image, *found[:2], 2, block, found[2], 50, counts)
        assert went == reference.descend(image, *expected[:2], block, 50)
