"""The payload of the punctured form: after the header, the bits that were asked for, in that order."""

from collections.abc import Generator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dvc.errors import BitstreamError
from dvc.slepian_wolf import ParityRequest
from dvc.wynerziv.layout import FrameLayout

Bits = NDArray[np.uint8]
Result = TypeVar("Result")


def disagreement(found: str) -> BitstreamError:
    """Return the error of a punctured stream that holds what another decoder asked for."""
    return BitstreamError(f"the punctured stream was made for other predictions than this decoder's: {found}")


class PuncturedFrame:
    """Answers requests from a punctured payload: whatever is asked, the next bits are the answer."""

    def __init__(self, layout: FrameLayout, payload: bytes) -> None:
        header_bytes = len(layout.read_header(payload).header)
        self._bits = np.unpackbits(np.frombuffer(payload, np.uint8)[header_bytes:])
        self._position = 0

    def answer(self, request: ParityRequest) -> Bits:
        """Return the next bits."""
        stop = self._position + request.count
        if stop > self._bits.size:
            raise disagreement(f"a Wyner-Ziv frame has {self._bits.size} bits, {stop} are needed")
        bits = self._bits[self._position : stop]
        self._position = stop
        return bits


class PunctureRecorder:
    """Collects the answers to requests as they pass, to be written as a punctured payload."""

    def __init__(self) -> None:
        self._bits: list[Bits] = []

    def watch(
        self, coroutine: Generator[ParityRequest, Bits, Result]
    ) -> Generator[ParityRequest, Bits, Result]:
        """Pass on requests of a coroutine, and keep the answers."""
        try:
            request = next(coroutine)
            while True:
                bits = yield request
                self._bits.append(bits)
                request = coroutine.send(bits)
        except StopIteration as stop:
            result: Result = stop.value
            return result

    def payload(self, header: bytes) -> bytes:
        """Pack what was collected; `PuncturedFrame` answers with it."""
        bits = np.concatenate(self._bits) if self._bits else np.zeros(0, np.uint8)
        return header + np.packbits(bits).tobytes()
