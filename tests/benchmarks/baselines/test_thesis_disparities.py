"""Rate models: the Laplacian distribution, and the search for its parameter."""

import math

import numpy as np
import pytest

from benchmarks.baselines.thesis_disparities import (
    LAMBDA_TOLERANCE,
    MIN_SCALE,
    Laplacian,
    laplacian_costs,
    search_laplacian,
    significant_magnitudes,
)
from dvc.dibr.disparity.disparity_codec import all_significant
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM, S_TRANSFORM, IntegerTransform


@pytest.mark.parametrize("scale", [0.05, 0.4, 3.0, 50.0])
def test_probabilities_add_up(scale: float) -> None:
    """The distribution sums to 1 over both signs (3.17)."""
    bits = Laplacian(scale, 15).bits(np.abs(np.arange(-15.0, 16.0)))
    assert (2.0**-bits).sum() == pytest.approx(1.0)


@pytest.mark.parametrize("scale", [0.3, 1.0, 4.0])
def test_the_scale_is_found_again(scale: float) -> None:
    """Magnitudes drawn from a distribution have its parameter, within 5 %."""
    values = np.arange(-60, 61)
    probability = 2.0 ** -Laplacian(scale, 60).bits(np.abs(values).astype(float))
    drawn = np.random.default_rng(0).choice(values, 20000, p=probability / probability.sum())
    assert Laplacian.fitted(np.abs(drawn), 60).scale == pytest.approx(scale, rel=0.05)


def test_zeros_alone_have_the_least_scale() -> None:
    """A parameter of 0 is not reached."""
    assert Laplacian.fitted(np.zeros(9, np.int32), 60).scale == MIN_SCALE
    assert Laplacian.fitted(np.zeros(0, np.int32), 60).scale == MIN_SCALE


def test_costs_are_bits_but_for_a_constant() -> None:
    """Lambda times bits less mu times the magnitude is the same for all coefficients (3.19)."""
    multiplier, model = 2e-3, Laplacian(0.7, 20)
    mu = multiplier / (model.scale * math.log(2.0))
    cost = laplacian_costs((2, 2), all_significant((2, 2)), mu)[0].coefficients[1]
    magnitude = np.arange(21.0)
    rest = multiplier * model.bits(magnitude) - (cost[1] + cost[2] * magnitude)
    np.testing.assert_allclose(rest, multiplier * model.log2_partition, rtol=1e-5)


@pytest.mark.parametrize("transform", [L_TRANSFORM, S_TRANSFORM], ids=lambda one: one.name)
def test_the_search_ends_at_lambda(transform: IntegerTransform) -> None:
    """At the end mu b ln 2 is lambda (3.33), within the tolerance and what one step of mu changes."""
    rng = np.random.default_rng(1)
    labels = np.add.outer(np.arange(32) // 6, np.arange(32) // 4)
    tensor = np.abs(labels[:, :, None] - np.arange(14)) * 0.02 + rng.uniform(0.0, 0.03, (32, 32, 14))
    significance = all_significant((32, 32))
    tree, model = search_laplacian(transform, tensor.astype(np.float32), 4e-3, significance)
    magnitudes = significant_magnitudes(tree, significance)
    assert model == Laplacian.fitted(magnitudes, 14)
    count = 32 * 32 - 1 if transform is S_TRANSFORM else (4**6 - 4) // 3
    assert magnitudes.size == count
    mu = 4e-3 / (model.scale * math.log(2.0))
    again, _ = search_laplacian(transform, tensor.astype(np.float32), 4e-3, significance, max_iterations=30)
    assert Laplacian.fitted(significant_magnitudes(again, significance), 14).scale == pytest.approx(
        4e-3 / (mu * math.log(2.0)), rel=10 * LAMBDA_TOLERANCE
    )
