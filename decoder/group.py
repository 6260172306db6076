"""Decoding of the Wyner-Ziv frames of one group of pictures between two decoded key frames."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.methods import METHODS
from decoder.side_information.protocol import ReferenceFrame
from decoder.wyner_ziv import DecodedFrame, FrameCoroutine, WynerZivDecoder
from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.feedback import ParityRequest
from dvc.stream import GopRecord
from dvc.tracks import FeaturePoints, PointTracks, decode_points, decode_tracks
from dvc.video import Frame
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


@dataclass(frozen=True)
class DecodedGroup:
    """One decoded group of pictures.

    Attributes
    ----------
    first_index : int
        Display position of its first frame.
    wyner_ziv : tuple of DecodedWynerZiv
        Its Wyner-Ziv frames, in display order.
    key : Frame
        The key frame that ends it.
    record : GopRecord
        The record of the punctured form: what was really needed.
    """

    first_index: int
    wyner_ziv: tuple[DecodedWynerZiv, ...]
    key: Frame
    record: GopRecord

    @classmethod
    def of(
        cls, first_index: int, wyner_ziv: Sequence[DecodedWynerZiv], key: Frame, record: GopRecord
    ) -> "DecodedGroup":
        """Return a group with the record of what was needed.

        Parameters
        ----------
        first_index : int
            Display position of its first frame.
        wyner_ziv : sequence of DecodedWynerZiv
            Its Wyner-Ziv frames.
        key : Frame
            Its key frame.
        record : GopRecord
            What the stream, or the encoder, sent of it.

        Returns
        -------
        DecodedGroup
            The group.
        """
        needed = GopRecord(
            record.num_frames, record.key, record.tracks, tuple(frame.punctured for frame in wyner_ziv)
        )
        return cls(first_index, tuple(wyner_ziv), key, needed)


@contextmanager
def naming_group(number: int, part: str = "") -> Iterator[None]:
    """Say of damage in which group of pictures it is.

    Parameters
    ----------
    number : int
        Number of the group, from 0.
    part : str, optional
        What comes before the reason.
    """
    try:
        yield
    except BitstreamError as err:
        raise BitstreamError(f"group of pictures {number}: {part}{err}") from err


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


def _usable(known: Iterable[int], around: tuple[int, int], references: str) -> list[int]:
    """Choose the references of a frame, key frames included: all, or those between which it is decoded."""
    if references == "all":
        return sorted(known)
    return sorted({min(known), *around, max(known)})


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
        self, keys: tuple[ReferenceFrame, ReferenceFrame], record: GopRecord, form: str
    ) -> list[DecodedWynerZiv]:
        """Decode a group from a stream.

        Parameters
        ----------
        keys : tuple of two ReferenceFrame
            The key frames around the group.
        record : GopRecord
            Its tracks, and one payload for each frame between the key frames.
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
        layout, payloads = self._decoder.layout, record.wyner_ziv
        first = keys[0].index + 1

        def _serve(index: int, frame: FrameCoroutine) -> DecodedFrame:
            payload = payloads[index - first]
            if form == "buffered":
                return run(frame, BufferedFrame(layout, payload, self._decoder.num_codes).answer)
            source = PuncturedFrame(layout, payload)
            decoded = run(frame, source.answer)
            source.finish()
            return decoded

        headers = [payload[: layout.header_bytes] for payload in payloads]
        return self._decode(keys, record.tracks, headers, _serve)

    def decode_live(
        self, keys: tuple[ReferenceFrame, ReferenceFrame], record: GopRecord, answer: Answer
    ) -> list[DecodedWynerZiv]:
        """Decode a group whose parity is asked of the encoder.

        Parameters
        ----------
        keys : tuple of two ReferenceFrame
            The key frames around the group.
        record : GopRecord
            Its tracks, and the header of each frame between the key frames.
        answer : callable
            Turns a request into bits.

        Returns
        -------
        list of DecodedWynerZiv
            In display order.

        Raises
        ------
        BitstreamError
            If tracks or headers are damaged.
        """
        return self._decode(keys, record.tracks, record.wyner_ziv, lambda _, frame: run(frame, answer))

    def _decode(
        self,
        keys: tuple[ReferenceFrame, ReferenceFrame],
        tracks: bytes,
        headers: Sequence[bytes],
        decode: Callable[[int, FrameCoroutine], DecodedFrame],
    ) -> list[DecodedWynerZiv]:
        known = {key.index: key for key in keys}
        points = self._received(tracks, len(headers))
        results = []
        hierarchical = self._config.gop.references != "keys"
        for index, around in decoding_order(keys[0].index, keys[1].index, hierarchical):
            started = time.perf_counter()
            references = [known[k] for k in _usable(known, around, self._config.gop.references)]
            prediction = self._method.predict(references, points, [index])[0]
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

    def _received(self, tracks: bytes, num_frames: int) -> PointTracks | FeaturePoints | None:
        """Read what was sent of the geometry of a group."""
        kind = self._config.tracks.kind
        if kind == "none" and tracks:
            raise BitstreamError("tracks in a stream whose configuration has none")
        if not tracks:
            return None
        if kind == "encoder":
            return decode_tracks(tracks, num_frames + 2, self._config)
        return decode_points(tracks, num_frames, self._config)


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
