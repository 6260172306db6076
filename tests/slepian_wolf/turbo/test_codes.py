"""Tests of code descriptions."""

import pytest

from dvc.slepian_wolf.turbo.codes import CLASSICAL, TurboCode


def test_classical_is_two_constituents_with_period_48() -> None:
    """The classical code is that of the literature."""
    assert TurboCode(feedback=0b11001, feedforward=0b11011, period=48) == CLASSICAL


@pytest.mark.parametrize("changes", [(0b1000, 0b11011, 48), (0b11001, 0b10, 48), (0b11001, 0b11011, 0)])
def test_refuses_what_is_no_code(changes: tuple[int, int, int]) -> None:
    """Polynomials without a constant term, and periods below one, are refused."""
    with pytest.raises(ValueError, match=r"constant term|period"):
        TurboCode(*changes)
