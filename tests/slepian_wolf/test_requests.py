"""Coroutines that ask for bits: one alone, and several side by side."""

from collections.abc import Generator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from dvc.slepian_wolf import ParityRequest, ask, drive, together

Bits = NDArray[np.uint8]


def asking(frame: int, counts: list[int]) -> Generator[ParityRequest, Bits, list[int]]:
    """Ask for so many bits each time, and return their sums."""
    sums = []
    for number, count in enumerate(counts):
        bits = yield from ask(ParityRequest(frame, number % 3, "uncoded", 0, number, count))
        sums.append(int(bits.sum()))
    return sums


def answer(request: ParityRequest) -> Bits:
    """Return bits that depend on all that is asked."""
    rng = np.random.default_rng((request.frame, request.plane, request.start))
    return rng.integers(0, 2, request.count, dtype=np.uint8)


@given(st.lists(st.lists(st.integers(1, 9), max_size=5), max_size=5), st.randoms(use_true_random=False))
def test_any_order_of_answers_gives_the_same(several: list[list[int]], random: object) -> None:
    """Side by side each comes to what it comes to alone, whichever of those that wait is answered next."""
    steps = together([asking(frame, counts) for frame, counts in enumerate(several)])
    waiting: list[ParityRequest] = []
    try:
        waiting += next(steps)
        while True:
            random.shuffle(waiting)  # type: ignore[attr-defined]
            request = waiting.pop()
            waiting += steps.send(((request.frame, request.plane), answer(request)))
    except StopIteration as stop:
        found = stop.value
    assert not waiting
    assert found == [drive(asking(frame, counts), answer) for frame, counts in enumerate(several)]


def test_wrong_answers_are_refused() -> None:
    """Bits that are too many reach the coroutine that asked, which refuses them."""
    steps = together([asking(0, [3])])
    assert len(next(steps)) == 1
    with pytest.raises(ValueError, match="expected 3 uncoded bits"):
        steps.send(((0, 0), np.zeros(4, np.uint8)))
