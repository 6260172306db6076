"""Requests of a decoder, and the drivers of coroutines that yield them."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

Bits = NDArray[np.uint8]
MAX_RUN_BITS = 2**20
"""Bits of a run: those of a plane of the largest frames; a decoder takes some hundred bytes for each."""
Kind = Literal["crc", "parity", "uncoded", "joint"]
KINDS: tuple[Kind, ...] = ("crc", "parity", "uncoded", "joint")
"""Check bits, parity, the bits of the plane themselves, or check bits of several planes together."""


class Part(NamedTuple):
    """Bits of one frame in a run: those of some of its planes, one plane after the other."""

    offset: int  # of the frame, in display order, from that which names the run
    planes: tuple[int, ...]  # increasing
    areas: bytes = b""  # areas of the frame, coded as both ends agree; none: all areas


Run = tuple[Part, ...]
"""Bits that are decoded together: of one frame after the other, in display order."""


@dataclass(frozen=True)
class ParityRequest:
    """Bits of a run that are wanted: `count` of them from number `start` on, in their order of release.

    Parities of ranges have no such order: `positions` says where the ranges end. Joint check bits always
    start with the first one; `run` is the first of those that `positions` names.
    """

    frame: int  # that names the run: its number in the sequence, from 0 in order of display
    run: int  # number of the run: as many with this frame were begun before
    kind: Kind
    code: int  # number of the code in its family; the same for all requests of a run
    start: int  # number of the first wanted bit: as many as were asked for before
    count: int  # number of bits
    positions: tuple[int, ...] = ()  # increasing: positions in order number `code`, or runs
    begun: Run | None = None  # with the first request for a run: which bits it has


FRAME, RUN, KIND, CODE, START, COUNT, LAST, SLOT, BEGUN = range(9)
NUM_COLUMNS = 9
"""Columns of a `RequestTable`: numbers of frame, run, kind and code; first bit and number of bits; where its
positions end among all; where the frame is held, if that is known; the run that it begins among all, or -1.
"""


class RequestTable(NamedTuple):
    """Requests in the order of their answers, as columns."""

    rows: NDArray[np.int64]  # a request each; see `FRAME` to `BEGUN`
    positions: NDArray[np.int64]  # their positions, one request's after the other's
    num_bits: int  # bits that are wanted in all
    runs: tuple[Run, ...] = ()  # that begin with a request

    @classmethod
    def of(cls, requests: Sequence[ParityRequest]) -> "RequestTable":
        """Return requests as a table."""
        ends = accumulate(len(request.positions) for request in requests)
        begun = accumulate(request.begun is not None for request in requests)
        rows = [
            (request.frame, request.run, KINDS.index(request.kind), request.code, request.start,
             request.count, end, 0, -1 if request.begun is None else number - 1)
            for request, end, number in zip(requests, ends, begun, strict=True)
        ]  # fmt: skip
        positions = [position for request in requests for position in request.positions]
        return cls(
            np.array(rows, np.int64).reshape(-1, NUM_COLUMNS),
            np.array(positions, np.int64),
            sum(request.count for request in requests),
            tuple(request.begun for request in requests if request.begun is not None),
        )

    def divided(self, packed: bytes) -> list[Bits]:
        """Return the bits that each request wants, of those that all want."""
        bits = np.unpackbits(np.frombuffer(packed, np.uint8), count=self.num_bits)
        return np.split(bits, np.cumsum(self.rows[:, COUNT]))[:-1]

    def requests(self) -> list[ParityRequest]:
        """Return the requests of the table."""
        rows, positions = self.rows.tolist(), self.positions.tolist()
        ends = [0, *(row[LAST] for row in rows)]
        return [
            ParityRequest(
                row[FRAME], row[RUN], KINDS[row[KIND]], row[CODE], row[START], row[COUNT],
                tuple(positions[first:last]), None if row[BEGUN] < 0 else self.runs[row[BEGUN]],
            )
            for row, (first, last) in zip(rows, pairwise(ends), strict=True)
        ]  # fmt: skip


Round = Sequence[ParityRequest]
"""Requests for different runs that are made, and answered, together."""
Answer = Callable[[Round], Sequence[Bits]]
"""Turns requests into the bits of each: ndarray of shape (count,), uint8."""
Place = tuple[int, int]
"""Index of a frame, and number of a run: at most one request for a run waits for its answer."""
Asked = TypeVar("Asked")
Given = TypeVar("Given")
Result = TypeVar("Result")


def ask(request: ParityRequest) -> Generator[ParityRequest, Bits, Bits]:
    """Yield a request and look at the answer."""
    bits = np.asarray((yield request))
    if bits.shape != (request.count,) or bits.dtype != np.uint8 or (bits.size and bits.max() > 1):
        wanted = f"{request.count} {request.kind} bits"
        raise ValueError(f"expected {wanted} as uint8, got {bits.dtype} of shape {bits.shape}")
    return bits


def beginning(
    run: Run, coroutine: Generator[ParityRequest, Bits, Result]
) -> Generator[ParityRequest, Bits, Result]:
    """Attach the run to the first request of a coroutine."""
    try:
        bits = yield replace(next(coroutine), begun=run)
        while True:
            bits = yield coroutine.send(bits)
    except StopIteration as stop:
        result: Result = stop.value
        return result


def drive(coroutine: Generator[Asked, Given, Result], answer: Callable[[Asked], Given]) -> Result:
    """Drive a decoding coroutine with answers to its requests, or to its rounds of requests."""
    try:
        asked = next(coroutine)
        while True:
            asked = coroutine.send(answer(asked))
    except StopIteration as stop:
        result: Result = stop.value
        return result


def side_by_side(
    coroutines: Sequence[Generator[ParityRequest, Bits, Result]],
) -> Generator[Round, Sequence[Bits], list[Result]]:
    """Advance decoding coroutines in step: their requests form one round."""
    results: dict[int, Result] = {}
    answers: dict[int, Bits | None] = dict.fromkeys(range(len(coroutines)))
    while True:
        asked: dict[int, ParityRequest] = {}
        for number, answer in answers.items():
            try:
                coroutine = coroutines[number]
                asked[number] = next(coroutine) if answer is None else coroutine.send(answer)
            except StopIteration as stop:
                results[number] = stop.value
        if not asked:
            return [results[number] for number in range(len(coroutines))]
        bits = yield tuple(asked.values())
        answers = dict(zip(asked, bits, strict=True))
