"""Tests of code descriptions and families."""

import json
from dataclasses import replace

import pytest

from dvc.slepian_wolf import TurboCode, choose_code, family

ALL = (*family("adaptive"), *family("classical"))


@pytest.mark.parametrize("code", ALL, ids=lambda code: code.name)
def test_survives_json(code: TurboCode) -> None:
    """A code that went through JSON equals the original."""
    assert TurboCode.from_dict(json.loads(json.dumps(code.to_dict()))) == code


def test_classical_is_two_constituents_with_period_48() -> None:
    """The classical family is the code of the literature."""
    (code,) = family("classical")
    assert (code.layout, code.period, code.copies) == ("parallel", 48, ((1.0, 2),))
    assert (code.feedback, code.feedforward) == (0b11001, 0b11011)


def test_choice_follows_entropy() -> None:
    """The chosen index never falls with entropy, and every code of the family is chosen somewhere."""
    codes = family("adaptive")
    chosen = [choose_code(codes, k / 1000) for k in range(1001)]
    assert chosen == sorted(chosen)
    assert set(chosen) == set(range(len(codes)))
    assert choose_code(codes, 2.0) == len(codes) - 1


@pytest.mark.parametrize(
    "changes",
    [
        {"copies": ()},
        {"copies": ((0.5, 2),)},
        {"copies": ((1.0, 0),)},
        {"layout": "parallel"},
        {"layout": "circular"},
        {"grid_rate": 1.5},
        {"feedback": 0b110},
    ],
)
def test_refuses_nonsense(changes: dict[str, object]) -> None:
    """Descriptions that make no code are refused."""
    with pytest.raises(ValueError, match=r"copies|fractions|parallel|layout|polynomials"):
        replace(ALL[0], **changes)  # type: ignore[arg-type]


def test_refuses_unknown_family() -> None:
    """An unknown family is refused by name."""
    with pytest.raises(ValueError, match="'ldpc'"):
        family("ldpc")
