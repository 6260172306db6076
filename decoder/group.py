"""Decoding of the Wyner-Ziv frames of one group of pictures between two decoded key frames."""

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from decoder.side_information.methods import METHODS
from decoder.side_information.protocol import ReferenceFrame
from decoder.wyner_ziv import DecodedFrame, WynerZivDecoder
from dvc import turbo
from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.stream import Form, GopRecord
from dvc.tracks import FeaturePoints, PointTracks, decode_points, decode_tracks
from dvc.turbo import Answer
from dvc.video import Frame
from dvc.wynerziv.buffered import BufferedFrame
from dvc.wynerziv.punctured import PuncturedFrame, PunctureRecorder


@dataclass(frozen=True)
class DecodedGroup:
    """One decoded group of pictures.

    Attributes
    ----------
    first_index : int
        Display position of its first frame.
    wyner_ziv : tuple of DecodedFrame
        Its Wyner-Ziv frames, in display order.
    key : Frame
        The key frame that ends it.
    record : GopRecord
        The record of the punctured form: what was really needed.
    """

    first_index: int
    wyner_ziv: tuple[DecodedFrame, ...]
    key: Frame
    record: GopRecord

    @property
    def key_index(self) -> int:
        """Display position of the key frame."""
        return self.first_index + len(self.wyner_ziv)

    @classmethod
    def of(
        cls, first_index: int, wyner_ziv: Sequence[DecodedFrame], key: Frame, record: GopRecord
    ) -> "DecodedGroup":
        """Return a group with the record of what was needed.

        Parameters
        ----------
        first_index : int
            Display position of its first frame.
        wyner_ziv : sequence of DecodedFrame
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

    Yields
    ------
    None
        Nothing; `BitstreamError` of the block is raised again with the name.
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

    def decode(
        self,
        keys: tuple[ReferenceFrame, ReferenceFrame],
        record: GopRecord,
        source: Form | Answer,
    ) -> list[DecodedFrame]:
        """Decode the Wyner-Ziv frames of a group.

        Parameters
        ----------
        keys : tuple of two ReferenceFrame
            The key frames around the group.
        record : GopRecord
            Its tracks, and a payload for each frame between the key frames.
        source : Form or callable
            Form of the payloads, or who answers requests where payloads are headers alone.

        Returns
        -------
        list of DecodedFrame
            In display order.

        Raises
        ------
        BitstreamError
            If tracks or payloads are damaged.
        """
        known = {key.index: key for key in keys}
        points = self._received(record.tracks, len(record.wyner_ziv))
        layout, references = self._decoder.layout, self._config.gop.references
        results = []
        for index, around in decoding_order(keys[0].index, keys[1].index, references != "keys"):
            started = time.perf_counter()
            usable = [known[k] for k in _usable(known, around, references)]
            prediction = self._method.predict(usable, points, [index])[0]
            payload = record.wyner_ziv[index - keys[0].index - 1]
            coroutine = self._decoder.decode(index, layout.read_header(payload), prediction)
            recorder = PunctureRecorder(self._answer(payload, source))
            decoded = turbo.drive(coroutine, recorder.answer)
            known[index] = ReferenceFrame(index, decoded.frame)
            punctured = recorder.payload(payload[: layout.header_bytes])
            if source == Form.PUNCTURED and len(punctured) < len(payload):
                raise BitstreamError(
                    f"punctured Wyner-Ziv frame of {len(payload)} bytes, {len(punctured)} are needed"
                )
            results.append(replace(decoded, punctured=punctured, decode_s=time.perf_counter() - started))
        return sorted(results, key=lambda result: result.index)

    def _answer(self, payload: bytes, source: Form | Answer) -> Answer:
        """Say who answers the requests of a frame."""
        if not isinstance(source, Form):
            return source
        if source is Form.BUFFERED:
            return BufferedFrame(self._decoder.layout, payload, self._decoder.num_codes).answer
        return PuncturedFrame(self._decoder.layout, payload).answer

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
