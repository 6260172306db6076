"""Labels from costs, by each method: smallest costs, messages, chains, and energies."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dvc.geometry import label_inference
from dvc.geometry.label_inference import BeliefPropagation, Inference, SemiGlobal
from tests.reference import cost_volumes as reference
from tests.twins import Choose, compiled_and_python

SHAPE = (6, 8)
NOTHING = np.zeros(SHAPE, np.int64)


_kind = compiled_and_python(label_inference, "chosen")


@pytest.mark.nojit
@pytest.mark.usefixtures("_kind")
def test_smallest_cost(rng: np.random.Generator) -> None:
    total = rng.random((*SHAPE, 7)).astype(np.float32)
    origin = rng.integers(-3, 9, SHAPE)
    found = label_inference.chosen(total, origin)
    best = total.argmin(axis=2)
    np.testing.assert_array_equal(found.label, best + origin)
    inner = (best > 0) & (best < 6)
    assert not found.offset[~inner].any()
    assert np.abs(found.offset).max() <= 0.5
    rows = found.rows(slice(2, 4))
    np.testing.assert_array_equal(rows.label, found.label[2:4])
    np.testing.assert_array_equal(rows.offset, found.offset[2:4])


@pytest.mark.nojit
@pytest.mark.usefixtures("_kind")
@pytest.mark.parametrize("minimum", [2.0, 2.2, 2.5, 2.9, 3.0])
def test_offset_points_to_the_minimum_between_labels(minimum: float) -> None:
    total = np.broadcast_to(np.abs(np.arange(6) - minimum), (*SHAPE, 6)).astype(np.float32)
    found = label_inference.chosen(total, NOTHING)
    np.testing.assert_allclose(found.label + found.offset, minimum, atol=1e-6)


@pytest.fixture(params=[SemiGlobal(), BeliefPropagation()], ids=lambda method: type(method).__name__)
def method(request: pytest.FixtureRequest) -> Inference:
    """Return a method."""
    method: Inference = request.param
    return method


def test_single_wrong_labels_are_smoothed_away(rng: np.random.Generator, method: Inference) -> None:
    shape, count = (30, 40), 9
    truth = np.where(np.indices(shape)[1] < 19, 2, 6)
    image = np.repeat(np.where(truth == 2, 60, 180)[:, :, None], 3, axis=2).astype(np.uint8)
    distance = np.abs(np.arange(count) - truth[:, :, None])
    cost = np.clip(np.minimum(0.4 * distance, 1.0) + rng.normal(0.4, 0.35, distance.shape), 0, 2)
    flat = np.zeros(shape, np.int64)
    alone = (cost.argmin(axis=2) != truth).mean()
    found = method.infer(cost.astype(np.float32), image, flat, flat)
    assert alone > 0.3
    assert (abs(found.label - truth) > 1).mean() < 0.02
    assert (found.label != truth).mean() < 0.6 * alone
    assert found.label.dtype == np.int64
    assert np.abs(found.offset).max() <= 0.5


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (2, 3)])
@pytest.mark.parametrize("count", [1, 4])
def test_small_views(rng: np.random.Generator, method: Inference, shape: tuple[int, int], count: int) -> None:
    cost, nothing = rng.random((*shape, count)).astype(np.float32), np.zeros(shape, np.int64)
    found = method.infer(cost, np.zeros((*shape, 3), np.uint8), nothing, nothing + 4)
    assert found.label.shape == shape
    if shape == (1, 1) or count == 1:
        np.testing.assert_array_equal(found.label, cost.argmin(axis=2) + 4)
    assert count > 1 or not found.offset.any()


def test_labels_are_deterministic(rng: np.random.Generator, method: Inference) -> None:
    cost, nothing = rng.random((9, 12, 5)).astype(np.float32), np.zeros((9, 12), np.int64)
    image, kept = rng.integers(0, 256, (9, 12, 3)).astype(np.uint8), cost.copy()
    first, second = (method.infer(cost, image, nothing, nothing) for _ in range(2))
    np.testing.assert_array_equal(first.label, second.label)
    np.testing.assert_array_equal(cost, kept)


JUMP = 20
"""A step of the base surface that is a discontinuity for any method."""


def strengths(method: BeliefPropagation, image: NDArray[np.uint8]) -> tuple[Any, Any]:
    """Return how strong the edges to the right, and downwards, are."""
    levels = image.astype(np.float64)
    parts = [np.exp(-np.abs(np.diff(levels, axis=k)).max(axis=2) / method.edge_levels) for k in (1, 0)]
    across, down = (method.edge_strength + (1.0 - method.edge_strength) * part for part in parts)
    return across, down


def rises(base: NDArray[np.int64]) -> tuple[Any, Any]:
    """Return the steps of a base surface to the right, and downwards; none at its jumps."""
    across, down = (np.diff(base, axis=k) for k in (1, 0))
    return np.where(abs(across) >= JUMP, 0, across), np.where(abs(down) >= JUMP, 0, down)


@pytest.mark.nojit
@pytest.mark.parametrize("shift", [-7, -2, -1, 0, 1, 3, 9])
def test_message(choose: Choose, rng: np.random.Generator, shift: int) -> None:
    for slope, limit in ((0.3, 0.8), (0.7, 0.5), (0.05, 2.0), (0.2, 0.6), (0.0, 0.4), (0.3, 0.0)):
        parts = rng.uniform(0, 1, (4, 6)).astype(np.float32)
        message, numbers = np.empty(6, np.float32), [np.float32(value) for value in (0.6, slope, limit)]
        work = choose(label_inference._message_space)(6, *numbers[1:])
        choose(label_inference._send)(*parts, *numbers, shift, message, work)
        expected = reference.message(parts.sum(axis=0).astype(np.float64), 0.6, slope, limit, shift)
        np.testing.assert_allclose(message, expected, atol=1e-5)


@pytest.mark.parametrize("upright", [False, True])
def test_chain_has_the_best_labels(upright: bool, rng: np.random.Generator) -> None:
    length, count = 14, 6
    method = BeliefPropagation(iterations=2 * length, levels=1)
    for _ in range(5):
        cost = rng.uniform(0, 1, (length, count)).astype(np.float32)
        image = rng.integers(0, 60, (1, length, 3)).astype(np.uint8)
        base = np.cumsum(rng.choice([-1, 0, 1, 1, JUMP], length))[None]
        strength, rise = strengths(method, image)[0][0], rises(base)[0][0]
        label, least = reference.viterbi(cost.astype(np.float64), strength, rise, method.slope, method.limit)
        arguments = cost[None], image, base
        if upright:
            arguments = cost[:, None], image.transpose(1, 0, 2), base.T
        origin = np.zeros(arguments[2].shape, np.int64)
        found = method.infer(*arguments, origin)
        np.testing.assert_array_equal(found.label.ravel(), label)
        energy = reference.energy(
            cost[None].astype(np.float64),
            label[None],
            (strength[None], np.empty((0, length))),
            (rise[None], np.empty((0, length), np.int64)),
            method.slope,
            method.limit,
        )
        assert energy == pytest.approx(least)


def test_without_smoothness_every_pixel_is_alone(rng: np.random.Generator) -> None:
    """Zero smoothness gives the smallest cost of each pixel (2.13)."""
    cost = rng.random((9, 11, 5)).astype(np.float32)
    image, nothing = rng.integers(0, 256, (9, 11, 3)).astype(np.uint8), np.zeros((9, 11), np.int64)
    found = BeliefPropagation(slope=0.0).infer(cost, image, nothing, nothing)
    np.testing.assert_array_equal(found.label, cost.argmin(axis=2))
    found = BeliefPropagation(limit=0.0).infer(cost, image, nothing, nothing)
    np.testing.assert_array_equal(found.label, cost.argmin(axis=2))


def test_band_around_a_surface_is_the_same_as_all_labels(rng: np.random.Generator) -> None:
    shape, count = (8, 10), 12
    origin = rng.integers(0, 3, shape)
    band = rng.random((*shape, count - 3)).astype(np.float32)
    whole = np.full((*shape, count), 40.0, np.float32)
    for at in np.ndindex(shape):
        whole[at][origin[at] : origin[at] + count - 3] = band[at]
    image, base = rng.integers(0, 40, (*shape, 3)).astype(np.uint8), rng.integers(3, 6, shape)
    method = BeliefPropagation(levels=1, iterations=12)
    nothing = np.zeros(shape, np.int64)
    expected, found = method.infer(whole, image, base, nothing), method.infer(band, image, base, origin)
    np.testing.assert_array_equal(found.label, expected.label)


def test_slopes_of_the_base_cost_nothing(rng: np.random.Generator) -> None:
    shape, count = (12, 30), 32
    base = np.broadcast_to(np.arange(30), shape).astype(np.int64)
    distance = np.abs(np.arange(count) - base[:, :, None] - 1)
    cost = (0.5 * np.minimum(distance, 4) * (np.indices(shape)[1] % 6 == 0)[:, :, None]).astype(np.float32)
    cost += rng.uniform(0.0, 0.01, cost.shape).astype(np.float32)
    image, nothing = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.int64)
    method = BeliefPropagation(levels=1, iterations=40)
    np.testing.assert_array_equal(method.infer(cost, image, base, nothing).label, base + 1)
    assert (method.infer(cost, image, nothing, nothing).label != base + 1).mean() > 0.3


def test_energy_is_below_that_of_scanlines(rng: np.random.Generator) -> None:
    """On random grids (2.13) is lower than with labels of scanlines, or of each pixel by itself."""
    method = BeliefPropagation(iterations=15)
    sums = np.zeros(3)
    nothing = np.zeros((16, 20), np.int64)
    for _ in range(6):
        truth = np.add.outer(np.arange(16) // 8 * 3, np.arange(20) // 7)
        image = (60 + 30 * truth[:, :, None] + rng.integers(0, 6, (16, 20, 3))).astype(np.uint8)
        cost = np.minimum(0.3 * np.abs(np.arange(8) - truth[:, :, None]), 0.8)
        cost = np.clip(cost + rng.normal(0.3, 0.3, cost.shape), 0.0, 2.0).astype(np.float32)
        found = [
            method.infer(cost, image, nothing, nothing).label,
            SemiGlobal().infer(cost, image, nothing, nothing).label,
            cost.argmin(axis=2),
        ]
        edges = strengths(method, image), rises(nothing)
        exact = cost.astype(np.float64)
        energies = [reference.energy(exact, label, *edges, method.slope, method.limit) for label in found]
        assert energies[0] < energies[2]
        sums += energies
    assert sums[0] < sums[1] < sums[2]
