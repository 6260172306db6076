"""Coroutines that ask for bits."""

from collections.abc import Generator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from dvc.slepian_wolf import (
    KINDS,
    ParityRequest,
    Part,
    RequestTable,
    Round,
    ask,
    beginning,
    drive,
    side_by_side,
)

Bits = NDArray[np.uint8]
NUMBERS = st.integers(0, 2**20)
INCREASING = st.sets(NUMBERS, max_size=5).map(lambda numbers: tuple(sorted(numbers)))
RUNS = st.lists(st.builds(Part, NUMBERS, INCREASING, st.binary(max_size=5)), max_size=3).map(tuple)
REQUESTS = st.builds(
    ParityRequest, NUMBERS, NUMBERS, st.sampled_from(KINDS), NUMBERS, NUMBERS, st.integers(1, 40), INCREASING,
    st.none() | RUNS,
)  # fmt: skip


def asking(frame: int, counts: list[int]) -> Generator[ParityRequest, Bits, list[int]]:
    """Ask for so many bits each time, and return their sums."""
    sums = []
    for number, count in enumerate(counts):
        bits = yield from ask(ParityRequest(frame, number % 3, "uncoded", 0, number, count))
        sums.append(int(bits.sum()))
    return sums


def answer(request: ParityRequest) -> Bits:
    """Return bits that depend on all that is asked."""
    rng = np.random.default_rng((request.frame, request.run, request.start))
    return rng.integers(0, 2, request.count, dtype=np.uint8)


def test_what_is_asked_for_is_answered_in_turn() -> None:
    """A coroutine is sent the answer to each of its requests, and what it returns is returned."""
    counts = [3, 1, 9, 2]
    wanted = [answer(ParityRequest(4, k % 3, "uncoded", 0, k, count)).sum() for k, count in enumerate(counts)]
    assert drive(asking(4, counts), answer) == wanted
    assert drive(asking(4, []), answer) == []


def test_wrong_answers_are_refused() -> None:
    with pytest.raises(ValueError, match="expected 3 uncoded bits"):
        drive(asking(0, [3]), lambda _: np.zeros(4, np.uint8))


def test_those_side_by_side_ask_together_until_each_has_ended() -> None:
    """What they return is what each returns alone, in their order; a round has a request of each at work."""
    several = [[3, 1, 9, 2], [], [5], [2, 2]]
    rounds: list[list[int]] = []

    def answered(requests: Round) -> list[Bits]:
        rounds.append([request.frame for request in requests])
        return [answer(request) for request in requests]

    together = drive(side_by_side([asking(k, own) for k, own in enumerate(several)]), answered)
    assert together == [drive(asking(k, own), answer) for k, own in enumerate(several)]
    assert rounds == [[0, 2, 3], [0, 3], [0], [0]]


def test_too_few_answers_are_refused() -> None:
    with pytest.raises(ValueError, match="zip"):
        drive(side_by_side([asking(0, [3]), asking(1, [1])]), lambda requests: [answer(requests[0])])


@given(st.lists(REQUESTS, max_size=6))
def test_tables_hold_requests_and_runs_as_they_are(requests: list[ParityRequest]) -> None:
    """Positions and runs come back with their requests, and bits of all are divided among them."""
    table = RequestTable.of(requests)
    assert table.requests() == requests
    assert table.runs == tuple(request.begun for request in requests if request.begun is not None)
    counts = [request.count for request in requests]
    assert table.num_bits == sum(counts)
    bits = np.random.default_rng(1).integers(0, 2, table.num_bits, dtype=np.uint8)
    divided = table.divided(np.packbits(bits).tobytes())
    assert [own.size for own in divided] == counts
    np.testing.assert_array_equal(np.concatenate([*divided, bits[:0]]), bits)


def test_only_the_first_request_says_for_which_run_it_is() -> None:
    """Others, and what is returned, are as they are without; so is a coroutine that asks for nothing."""
    run, asked = (Part(0, (2, 5), b"areas"), Part(3, (1,))), []

    def answered(request: ParityRequest) -> Bits:
        asked.append(request)
        return answer(request)

    counts = [3, 1, 9]
    assert drive(beginning(run, asking(4, counts)), answered) == drive(asking(4, counts), answer)
    wanted = [ParityRequest(4, k, "uncoded", 0, k, count) for k, count in enumerate(counts)]
    wanted[0] = ParityRequest(4, 0, "uncoded", 0, 0, 3, begun=run)
    assert asked == wanted
    assert drive(beginning(run, asking(4, [])), answer) == []
