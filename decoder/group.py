"""Decoding of the Wyner-Ziv frames of one group of pictures, whose key frames are decoded already."""

import time
from collections.abc import Iterable
from dataclasses import replace

from decoder.one_way import OneWayDecoder
from decoder.side_information.extrapolation import TrackedExtrapolation
from decoder.side_information.methods import METHODS
from decoder.side_information.protocol import Prediction, ReferenceFrame
from decoder.tasks import DecodedFrame, DecodedGroup, GroupTask
from decoder.wyner_ziv import WynerZivDecoder
from dvc import turbo
from dvc.config import CodecConfig, GopConfig
from dvc.errors import BitstreamError
from dvc.stream import Form, GopRecord
from dvc.tracks import FeaturePoints, PointTracks, decode_points, decode_tracks
from dvc.turbo import Answer, num_codes
from dvc.wynerziv.buffered import BufferedFrame
from dvc.wynerziv.hierarchy import Around, group_order, reference_distance
from dvc.wynerziv.punctured import PuncturedFrame, PunctureRecorder, disagreement

Points = PointTracks | FeaturePoints | None


def _usable(known: Iterable[int], around: tuple[int, int], references: str) -> list[int]:
    """Choose the references of a frame, key frames included: all, or those between which it is decoded."""
    if references == "all":
        return sorted(known)
    return sorted({min(known), *around, max(known)})


def _order(task: GroupTask, gop: GopConfig) -> list[tuple[int, Around]]:
    """Return in which order the Wyner-Ziv frames of a group are decoded, and from which references."""
    anchor_distance = gop.anchor_distance if task.key is None else 0
    return group_order(task.first_index - 1, task.last_index, gop.references != "keys", anchor_distance)


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
        self._extrapolation = TrackedExtrapolation()
        self._decoder = WynerZivDecoder(config)
        self._one_way = OneWayDecoder(config)

    def decode(self, task: GroupTask, ask: Answer) -> DecodedGroup:
        """Decode a group.

        Parameters
        ----------
        task : GroupTask
            The group: key frames around it, tracks, and a payload, or only its header, for each frame.
        ask : callable
            Asks a live encoder for parity, where the task is of no stream.

        Returns
        -------
        DecodedGroup
            Its frames, and the record of what was needed.

        Raises
        ------
        BitstreamError
            If tracks, headers or payloads are damaged, or a punctured stream was made for other predictions.
        """
        if not task.record.wyner_ziv:
            return DecodedGroup.of(task, [])
        if task.before is None:
            raise BitstreamError("Wyner-Ziv frames without a frame before them")
        gop = self._config.gop
        known = {task.before.index: task.before}
        if task.key is not None:
            known[task.last_index] = ReferenceFrame(task.last_index, task.key)
        points = self._received(task.record.tracks, task.record.num_frames - 1)
        frames = []
        self._decoder.start_group()
        for index, around in _order(task, gop):
            started = time.perf_counter()
            prediction = self._predict(task, known, points, index, around)
            payload = task.record.wyner_ziv[index - task.first_index]
            if task.form is Form.ONE_WAY:
                frame = self._one_way.decode(index, payload, prediction)
            else:
                answer = self._answer(task.form, payload, ask)
                slope = self._config.wyner_ziv.slope_between(reference_distance(around))
                frame = self._decode_frame(index, prediction, payload, answer, slope)
            frame = replace(frame, decode_s=time.perf_counter() - started)
            known[index] = ReferenceFrame(index, frame.frame)
            frames.append(frame)
        group = DecodedGroup.of(task, sorted(frames, key=lambda frame: frame.index))
        if task.form is Form.PUNCTURED:
            _check_agreement(group.record, task.record)
        return group

    def _predict(
        self, task: GroupTask, known: dict[int, ReferenceFrame], points: Points, index: int, around: Around
    ) -> Prediction:
        if around[1] is None:
            earlier = [known[k] for k in sorted(known)]
            return self._extrapolation.predict(earlier, points, task.first_index - 1, index)
        usable = [known[k] for k in _usable(known, (around[0], around[1]), self._config.gop.references)]
        return self._method.predict(usable, points, [index])[0]

    def _decode_frame(
        self,
        index: int,
        prediction: Prediction,
        payload: bytes,
        answer: Answer,
        slope: float,
    ) -> DecodedFrame:
        quantization = self._decoder.layout.read_header(payload)
        recorder = PunctureRecorder(answer)
        steps = self._decoder.decode(index, quantization, prediction, slope)
        decoded = turbo.drive(steps, recorder.answer)
        return replace(decoded, punctured=recorder.payload(payload[: len(quantization.header)]))

    def _answer(self, form: Form | None, payload: bytes, ask: Answer) -> Answer:
        """Return who answers the requests for a frame."""
        layout = self._decoder.layout
        if form is Form.BUFFERED:
            return BufferedFrame(layout, payload, num_codes(self._config.turbo.family)).answer
        return ask if form is None else PuncturedFrame(layout, payload).answer

    def _received(self, tracks: bytes, num_frames: int) -> Points:
        """Read what was sent of the geometry of a group."""
        kind = self._config.tracks.kind
        if kind == "none" and tracks:
            raise BitstreamError("tracks in a stream whose configuration has none")
        if not tracks:
            return None
        if kind == "encoder":
            return decode_tracks(tracks, num_frames + 2, self._config)
        return decode_points(tracks, num_frames, self._config)


def _check_agreement(needed: GopRecord, sent: GopRecord) -> None:
    """Refuse a punctured group that this decoder would have made otherwise."""
    for ours, theirs in zip(needed.wyner_ziv, sent.wyner_ziv, strict=True):
        if len(ours) != len(theirs):
            raise disagreement(f"a Wyner-Ziv frame has {len(theirs)} bytes, {len(ours)} are needed")
    if sent.digest not in (None, needed.digest):
        raise disagreement(f"digest {needed.digest:08x} of the frames, {sent.digest:08x} in the stream")
