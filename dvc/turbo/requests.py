"""What a decoder asks for: one kind of request, and the driver of coroutines that yield them."""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

Bits = NDArray[np.uint8]
Kind = Literal["crc", "parity", "uncoded"]
KINDS: tuple[Kind, ...] = ("crc", "parity", "uncoded")
"""Check bits, parity, or the bits of the plane themselves."""


@dataclass(frozen=True)
class ParityRequest:
    """Bits of a plane that are wanted: `count` of them from number `start` on, in their order of release."""

    frame: int  # number of the Wyner-Ziv frame in the sequence, from 0 in order of display
    plane: int  # number of the plane in the frame, from 0
    kind: Kind
    code: int  # number of the code in its family; the same for all requests of a plane
    start: int  # number of the first wanted bit: as many as were asked for before
    count: int  # number of bits


Answer = Callable[[ParityRequest], Bits]
"""Turns a request into bits: ndarray of shape (count,), uint8."""
Result = TypeVar("Result")


def drive(coroutine: Generator[ParityRequest, Bits, Result], answer: Answer) -> Result:
    """Drive a decoding coroutine with answers to its requests.

    Parameters
    ----------
    coroutine : generator
        Yields requests, and is sent bits.
    answer : callable
        Turns a request into bits.

    Returns
    -------
    object
        What the coroutine returns.
    """
    try:
        request = next(coroutine)
        while True:
            request = coroutine.send(answer(request))
    except StopIteration as stop:
        result: Result = stop.value
        return result
