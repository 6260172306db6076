"""Labels from costs: the smallest one, its place between labels and its margin; and methods alike."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.multiview.volumes import _kernels as kernels
from dvc.multiview.volumes.belief_propagation import BeliefPropagation
from dvc.multiview.volumes.inference import Inference, SemiGlobal, chosen
from dvc.testing.inference import InferenceContract

SHAPE = (6, 8)
NOTHING = np.zeros(SHAPE, np.int64)


@pytest.fixture(params=["compiled", "python"])
def _kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run `chosen` on its compiled kernel, and on its Python."""
    if request.param == "python":
        function: Callable[..., Any] = python_twin(kernels.choose)
        monkeypatch.setattr(kernels, "choose", function)


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a fresh generator."""
    return np.random.default_rng(213)


@pytest.mark.nojit
@pytest.mark.usefixtures("_kind")
def test_smallest_cost_and_its_margin(rng: np.random.Generator) -> None:
    """The label of the smallest cost from the origin on, and its distance to what is not beside it."""
    total = rng.random((*SHAPE, 7)).astype(np.float32)
    origin = rng.integers(-3, 9, SHAPE)
    found = chosen(total, origin)
    best = total.argmin(axis=2)
    np.testing.assert_array_equal(found.label, best + origin)
    for at in np.ndindex(SHAPE):
        others = [cost for k, cost in enumerate(total[at]) if abs(k - best[at]) > 1]
        assert found.margin[at] == pytest.approx(min(others) - total[at].min())
    assert found.margin.min() >= 0.0
    inner = (best > 0) & (best < 6)
    assert not found.offset[~inner].any()
    assert np.abs(found.offset).max() <= 0.5
    rows = found.rows(slice(2, 4))
    np.testing.assert_array_equal(rows.label, found.label[2:4])
    np.testing.assert_array_equal(rows.margin, found.margin[2:4])


@pytest.mark.nojit
@pytest.mark.usefixtures("_kind")
@pytest.mark.parametrize("minimum", [2.0, 2.2, 2.5, 2.9, 3.0])
def test_offset_points_to_the_minimum_between_labels(minimum: float) -> None:
    """Of costs that rise alike to both sides the place is met, labels and offset together."""
    total = np.broadcast_to(np.abs(np.arange(6) - minimum), (*SHAPE, 6)).astype(np.float32)
    found = chosen(total, NOTHING)
    np.testing.assert_allclose(found.label + found.offset, minimum, atol=1e-6)


@pytest.mark.nojit
@pytest.mark.usefixtures("_kind")
@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_labels_have_no_rival(count: int) -> None:
    """Where no label but neighbours of the best one exists the margin is without bound, but a number."""
    found = chosen(np.ones((*SHAPE, count), np.float32), NOTHING)
    np.testing.assert_array_equal(found.label, 0)
    assert np.isfinite(found.margin).all()
    assert ((found.margin > 1e6) == (count < 3)).all()


class TestMethods(InferenceContract):
    """All methods."""

    @pytest.fixture(params=[SemiGlobal(), BeliefPropagation()], ids=lambda method: type(method).__name__)
    def method(self, request: pytest.FixtureRequest) -> Inference:
        """Return a method."""
        method: Inference = request.param
        return method
