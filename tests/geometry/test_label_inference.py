"""Labels from costs: the smallest one and its place between labels; and methods alike."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.geometry import label_inference
from dvc.geometry.label_inference import BeliefPropagation, Inference, SemiGlobal, chosen

SHAPE = (6, 8)
NOTHING = np.zeros(SHAPE, np.int64)


@pytest.fixture(params=["compiled", "python"])
def _kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run `chosen` on its compiled kernel, and on its Python."""
    if request.param == "python":
        function: Callable[..., Any] = python_twin(label_inference._choose)
        monkeypatch.setattr(label_inference, "_choose", function)


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a fresh generator."""
    return np.random.default_rng(213)


@pytest.mark.nojit
@pytest.mark.usefixtures("_kind")
def test_smallest_cost(rng: np.random.Generator) -> None:
    """The label of the smallest cost from the origin on; ends of the range have no place beside them."""
    total = rng.random((*SHAPE, 7)).astype(np.float32)
    origin = rng.integers(-3, 9, SHAPE)
    found = chosen(total, origin)
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
    """Of costs that rise alike to both sides the place is met, labels and offset together."""
    total = np.broadcast_to(np.abs(np.arange(6) - minimum), (*SHAPE, 6)).astype(np.float32)
    found = chosen(total, NOTHING)
    np.testing.assert_allclose(found.label + found.offset, minimum, atol=1e-6)


class InferenceContract:
    """Tests of a method; a class derived from this one says which, by the fixture `method`."""

    def test_single_wrong_labels_are_smoothed_away(self, method: Inference) -> None:
        """A surface of two levels comes out of noisy costs, with the jump where colours change."""
        rng = np.random.default_rng(213)
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

    def test_one_label_is_all_there_is(self, method: Inference) -> None:
        """A range of one label gives it, counted from the origin."""
        rng = np.random.default_rng(213)
        cost, nothing = rng.random((6, 8, 1)).astype(np.float32), np.zeros((6, 8), np.int64)
        found = method.infer(cost, np.zeros((6, 8, 3), np.uint8), nothing, nothing + 4)
        assert (found.label == 4).all()
        assert not found.offset.any()

    @pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (2, 3)])
    def test_small_views(self, method: Inference, shape: tuple[int, int]) -> None:
        """Views of a line or a pixel have labels, too."""
        rng = np.random.default_rng(213)
        cost = rng.random((*shape, 4)).astype(np.float32)
        nothing = np.zeros(shape, np.int64)
        found = method.infer(cost, np.zeros((*shape, 3), np.uint8), nothing, nothing)
        assert found.label.shape == shape
        if shape == (1, 1):
            assert found.label[0, 0] == cost.argmin()

    def test_labels_are_deterministic(self, method: Inference) -> None:
        """The same costs have the same labels; what was given is left as it was."""
        rng = np.random.default_rng(7)
        cost, nothing = rng.random((9, 12, 5)).astype(np.float32), np.zeros((9, 12), np.int64)
        image, kept = rng.integers(0, 256, (9, 12, 3)).astype(np.uint8), cost.copy()
        first, second = (method.infer(cost, image, nothing, nothing) for _ in range(2))
        np.testing.assert_array_equal(first.label, second.label)
        np.testing.assert_array_equal(cost, kept)


class TestMethods(InferenceContract):
    """All methods."""

    @pytest.fixture(params=[SemiGlobal(), BeliefPropagation()], ids=lambda method: type(method).__name__)
    def method(self, request: pytest.FixtureRequest) -> Inference:
        """Return a method."""
        method: Inference = request.param
        return method
