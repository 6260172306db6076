"""Decoding of the Wyner-Ziv frames of one group of pictures between two decoded key frames."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decoder.side_information import METHODS
from decoder.side_information.protocol import ReferenceFrame
from decoder.wyner_ziv import DecodedFrame, FrameCoroutine, WynerZivDecoder
from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.feedback import ParityRequest
from dvc.wynerziv.frame import BufferedFrame, PuncturedFrame, PunctureRecorder

Bits = NDArray[np.uint8]
Answer = Callable[[ParityRequest], Bits]


@dataclass(frozen=True)
class DecodedWynerZiv:
    """One decoded Wyner-Ziv frame, what it cost, and the payload that was really needed.

    Attributes
    ----------
    index : int
        Display position.
    decoded : DecodedFrame
        The frame.
    method, reason : str
        Side-information method that served it; why another one could not, if so.
    header_bits : int
        Bits of the frame's own header, padding of its payload included.
    punctured : bytes
        Payload of the punctured form.
    decode_s : float
        Wall-clock time, in seconds.
    """

    index: int
    decoded: DecodedFrame
    method: str
    reason: str
    header_bits: int
    punctured: bytes
    decode_s: float


def decoding_order(before: int, after: int, hierarchical: bool) -> list[tuple[int, tuple[int, int]]]:
    """Return in which order the frames between two key frames are decoded, and from which references.

    Parameters
    ----------
    before, after : int
        Display positions of the key frames.
    hierarchical : bool
        Whether the middle frame comes first and serves the others as a reference.

    Returns
    -------
    list of (int, (int, int))
        Display position of each frame, and of its two references.
    """
    if not hierarchical:
        return [(index, (before, after)) for index in range(before + 1, after)]
    order: list[tuple[int, tuple[int, int]]] = []
    spans = [(before, after)]
    for first, last in spans:
        if last - first >= 2:
            middle = (first + last) // 2
            order.append((middle, (first, last)))
            spans += [(first, middle), (middle, last)]
    return order


class GroupDecoder:
    """Decodes groups of pictures of one configuration.

    Parameters
    ----------
    config : CodecConfig
        Configuration of the stream.

    Raises
    ------
    BitstreamError
        If the stream asks for a side-information method that this decoder does not have.
    """

    def __init__(self, config: CodecConfig) -> None:
        method = config.side_information.method
        if method not in METHODS:
            raise BitstreamError(
                f"unknown side-information method {method!r}; there are {', '.join(METHODS)}"
            )
        self._config = config
        self._method = METHODS[method](config)
        self._decoder = WynerZivDecoder(config)

    def decode_payloads(
        self, keys: tuple[ReferenceFrame, ReferenceFrame], payloads: Sequence[bytes], form: str
    ) -> list[DecodedWynerZiv]:
        """Decode a group from a stream.

        Parameters
        ----------
        keys : tuple of two ReferenceFrame
            The key frames around the group.
        payloads : sequence of bytes
            One for each frame between them, in display order.
        form : str
            Form of the stream: buffered or punctured.

        Returns
        -------
        list of DecodedWynerZiv
            In display order.

        Raises
        ------
        BitstreamError
            If a payload is damaged.
        """
        layout = self._decoder.layout
        first = keys[0].index + 1

        def _serve(index: int, frame: FrameCoroutine) -> DecodedFrame:
            payload = payloads[index - first]
            if form == "buffered":
                return run(frame, BufferedFrame(layout, payload, self._decoder.num_codes).answer)
            source = PuncturedFrame(layout, payload)
            decoded = run(frame, source.answer)
            source.finish()
            return decoded

        return self._decode(keys, [payload[: layout.header_bytes] for payload in payloads], _serve)

    def decode_live(
        self, keys: tuple[ReferenceFrame, ReferenceFrame], headers: Sequence[bytes], answer: Answer
    ) -> list[DecodedWynerZiv]:
        """Decode a group whose parity is asked of the encoder.

        Parameters
        ----------
        keys : tuple of two ReferenceFrame
            The key frames around the group.
        headers : sequence of bytes
            Header of each frame between them, in display order.
        answer : callable
            Turns a request into bits.

        Returns
        -------
        list of DecodedWynerZiv
            In display order.
        """
        return self._decode(keys, headers, lambda _, frame: run(frame, answer))

    def _decode(
        self,
        keys: tuple[ReferenceFrame, ReferenceFrame],
        headers: Sequence[bytes],
        decode: Callable[[int, FrameCoroutine], DecodedFrame],
    ) -> list[DecodedWynerZiv]:
        known = {key.index: key for key in keys}
        results = []
        for index, around in decoding_order(
            keys[0].index, keys[1].index, self._config.gop.references != "keys"
        ):
            started = time.perf_counter()
            prediction = self._method.predict([known[k] for k in around], None, [index])[0]
            header = headers[index - keys[0].index - 1]
            recorder = PunctureRecorder()
            steps = self._decoder.layout.read_header(header)
            decoded = decode(index, recorder.watch(self._decoder.decode(index, steps, prediction)))
            known[index] = ReferenceFrame(index, decoded.frame)
            punctured = recorder.payload(header)
            header_bits = 8 * len(punctured) - decoded.crc_bits - decoded.parity_bits
            elapsed = time.perf_counter() - started
            results.append(
                DecodedWynerZiv(
                    index, decoded, prediction.method, prediction.reason, header_bits, punctured, elapsed
                )
            )
        return sorted(results, key=lambda result: result.index)


def run(frame: FrameCoroutine, answer: Answer) -> DecodedFrame:
    """Drive a frame's coroutine with answers to its requests.

    Parameters
    ----------
    frame : generator
        From `WynerZivDecoder.decode`.
    answer : callable
        Turns a request into bits.

    Returns
    -------
    DecodedFrame
        What the coroutine returns.
    """
    try:
        request = next(frame)
        while True:
            request = frame.send(answer(request))
    except StopIteration as stop:
        decoded: DecodedFrame = stop.value
        return decoded
