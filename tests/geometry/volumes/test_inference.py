"""Labels from costs: the smallest one and its place between labels; and methods alike."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.contracts.inference import InferenceContract
from dvc.geometry.volumes import _kernels as kernels
from dvc.geometry.volumes.belief_propagation import BeliefPropagation
from dvc.geometry.volumes.inference import Inference, SemiGlobal, chosen

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


class TestMethods(InferenceContract):
    """All methods."""

    @pytest.fixture(params=[SemiGlobal(), BeliefPropagation()], ids=lambda method: type(method).__name__)
    def method(self, request: pytest.FixtureRequest) -> Inference:
        """Return a method."""
        method: Inference = request.param
        return method
