"""Integer transforms: exact inverses, rounding, sizes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.dibr.disparity.integer_transforms import (
    L_TRANSFORM,
    S_TRANSFORM,
    IntegerTransform,
    level_shapes,
    synthesise_s,
)
from tests.reference.dibr_trees import analyse_s, analysed

TRANSFORMS = pytest.mark.parametrize("transform", [L_TRANSFORM, S_TRANSFORM], ids=lambda one: one.name)


def test_pairs_of_s_are_a_bijection() -> None:
    """Every pair of integers comes back, and every pair of coefficients is that of some samples (3.16)."""
    grid = (
        np.stack(np.meshgrid(np.arange(-40, 41), np.arange(-40, 41)), axis=-1).reshape(-1, 2).astype(np.int32)
    )
    low, high = analyse_s(grid, 1)
    np.testing.assert_array_equal(synthesise_s(low, high, 1), grid)
    samples = synthesise_s(grid[:, :1], grid[:, 1:], 1)
    np.testing.assert_array_equal(samples[:, 0] - samples[:, 1], grid[:, 1])
    np.testing.assert_array_equal(np.concatenate(analyse_s(samples, 1), axis=1), grid)


def test_coefficients_of_l_are_rounded_down() -> None:
    """High-pass coefficients of a pair add up to 0 or 1 (3.13)."""
    pairs = np.random.default_rng(0).integers(-9, 10, (1, 200)).astype(np.int32)
    high = analysed(L_TRANSFORM, pairs, 60, 1).highs[0]
    assert set(high[0, 0::2] + high[0, 1::2]) == {0, 1}


@given(st.integers(0, 2**32 - 1), st.integers(1, 21), st.integers(1, 21), st.sampled_from([None, 0, 1, 3]))
def test_maps_come_back(seed: int, height: int, width: int, num_levels: int | None) -> None:
    labels = np.random.default_rng(seed).integers(0, 60, (height, width)).astype(np.int32)
    for transform in (L_TRANSFORM, S_TRANSFORM):
        tree = analysed(transform, labels, 60, num_levels)
        np.testing.assert_array_equal(tree.disparity(), labels)
        shapes = level_shapes((height, width), num_levels)
        assert [level.shape for level in tree.levels()] == shapes
        for level in range(len(shapes)):
            np.testing.assert_array_equal(tree.disparity(level), np.clip(tree.levels()[level], 0, 59))


@TRANSFORMS
def test_a_constant_has_no_coefficients(transform: IntegerTransform) -> None:
    tree = analysed(transform, np.full((11, 6), 7, np.int32), 60)
    assert tree.roots.tolist() == [[7]]
    assert not any(high.any() for high in tree.highs)


def test_s_is_not_redundant() -> None:
    labels = np.random.default_rng(1).integers(0, 60, (9, 13)).astype(np.int32)
    for high in analysed(S_TRANSFORM, labels, 60).highs:
        assert not high[0::2, 0::2].any()
        assert high.any()
