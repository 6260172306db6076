"""Decoding of the Wyner-Ziv frames of one group of pictures, whose key frames are decoded already."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from threading import Lock
from typing import Protocol

import numpy as np

from decoder.allowances import Allowance, GroupAllowance
from decoder.learned import Learned
from decoder.side_information.methods import METHODS
from decoder.side_information.protocol import Prediction, ReferenceFrame
from decoder.tasks import Bits, DecodedFrame, DecodedGroup, GroupTask
from decoder.wyner_ziv import FrameCoroutine, WynerZivDecoder
from dvc import slepian_wolf
from dvc.config import CodecConfig
from dvc.errors import BitstreamError, DvcError
from dvc.slepian_wolf import Answer, Round
from dvc.stream import Form, GopRecord
from dvc.tracks import FeaturePoints, PointTracks, decode_points, decode_tracks
from dvc.wynerziv.encoder_buffer import EncoderBuffer
from dvc.wynerziv.hierarchy import Around, decoding_order, levels
from dvc.wynerziv.payloads import EncodedFrame, PuncturedFrame, PunctureRecorder, disagreement
from dvc.wynerziv.quantizer import FrameLayout

Points = PointTracks | FeaturePoints | None
Known = dict[int, ReferenceFrame]
Rank = tuple[int, int]
"""Levels that follow, negative, and the number of the group: the lowest comes first."""


class Encoder(Protocol):
    """Who answers what frames of a group ask for."""

    def decode_level(self, rank: Rank, frames: Sequence[FrameCoroutine]) -> list[DecodedFrame]:
        """Decode frames that do not depend on each other, answering their requests."""


def single_prediction(found: object, shape: tuple[int, ...], method: str) -> Prediction:
    """Return the prediction of one frame; what a method of others returns may be anything."""
    named = f"side information {method!r}"
    if not isinstance(found, Sequence) or len(found) != 1 or not isinstance(found[0], Prediction):
        raise DvcError(f"{named}: expected a list of one prediction for one instant")
    prediction: Prediction = found[0]
    if not prediction.compensated:
        raise DvcError(f"{named}: expected a compensated reference at least")
    finite = prediction.luma, *prediction.compensated
    errors = () if prediction.expected_error is None else (prediction.expected_error,)
    for plane in (*finite, *prediction.alternatives, *errors):
        if not isinstance(plane, np.ndarray):
            raise DvcError(f"{named}: expected arrays, got {type(plane).__name__}")
        if plane.shape != shape:
            sizes = ["x".join(map(str, size[::-1])) for size in (shape, plane.shape)]
            raise DvcError(f"{named}: expected predictions of {sizes[0]}, got {sizes[1]}")
    if not all(np.isfinite(plane).all() for plane in finite):
        raise DvcError(f"{named}: a prediction is not finite")
    return prediction


def _usable(known: Iterable[int], around: tuple[int, int], references: str) -> list[int]:
    """Choose the references of a frame, key frames included: all, or those between which it is decoded."""
    if references == "all":
        return sorted(known)
    return sorted({min(known), *around, max(known)})


def _order(task: GroupTask, config: CodecConfig) -> list[list[tuple[int, Around]]]:
    """Return which Wyner-Ziv frames of a group are decoded side by side, in order, from which references."""
    references = config.gop.references
    order = decoding_order(task.first_index - 1, task.last_index, references != "keys")
    return [[place] for place in order] if references == "all" else levels(order)


class GroupDecoder:
    """Decodes groups of pictures of one configuration."""

    def __init__(self, config: CodecConfig, frames: WynerZivDecoder | None = None) -> None:
        method = config.side_information.method
        if method not in METHODS:
            raise BitstreamError(METHODS.missing(repr(method)))
        self._config = config
        self._method = METHODS[method](config)
        self._decoder = frames or WynerZivDecoder(config)
        self._predicting = Lock()  # a method keeps what it knows of the group

    def decode(self, task: GroupTask, encoder: Encoder | None = None) -> DecodedGroup:
        """Decode a group, whose record answers unless an encoder does."""
        if not task.record.wyner_ziv:
            return DecodedGroup.of(task, [])
        if task.before is None:
            raise BitstreamError("Wyner-Ziv frames without a frame before them")
        last = ReferenceFrame(task.last_index, task.key)
        known = {task.before.index: task.before, last.index: last}
        points = self._received(task.record.tracks, task.record.num_frames - 1)
        encoder = encoder or RecordedGroup(task, self._config)
        frames: list[DecodedFrame] = []
        so_far, order = self._decoder.nothing_learned(), _order(task, self._config)
        allowance = GroupAllowance(self._told_bits(task))
        for levels_left, level in zip(range(len(order), 0, -1), order, strict=True):
            learned = [so_far.copy() for _ in level]
            allowed = allowance.begin_level([index for index, _ in level])
            coroutines = [
                self._frame(task, known, points, place, (own, may_ask))
                for place, own, may_ask in zip(level, learned, allowed, strict=True)
            ]
            decoded = encoder.decode_level((-levels_left, task.number), coroutines)
            so_far = so_far.joined(learned)
            allowance.end_level(sum(frame.crc_bits + frame.parity_bits for frame in decoded))
            known |= {frame.index: ReferenceFrame(frame.index, frame.frame) for frame in decoded}
            frames += decoded
        group = DecodedGroup.of(task, sorted(frames, key=lambda frame: frame.index))
        if task.form is Form.PUNCTURED:
            _check_agreement(group.record, task.record)
        return group

    def _told_bits(self, task: GroupTask) -> dict[int, int] | None:
        """Return how much the encoder allows because of each frame, if it does not allow all."""
        layout = self._decoder.layout
        if not layout.limited:
            return None
        headers = map(layout.read_header, task.record.wyner_ziv)
        return {index: header.told_bits or 0 for index, header in enumerate(headers, task.first_index)}

    def _frame(
        self,
        task: GroupTask,
        known: Known,
        points: Points,
        place: tuple[int, Around],
        own: tuple[Learned, Allowance],
    ) -> FrameCoroutine:
        """Decode one frame, without any request where its record holds what an encoder chose."""
        (index, around), started = place, time.perf_counter()
        payload = task.record.wyner_ziv[index - task.first_index]
        # Not held while the frame is decoded: its planes take as much memory as all else of a frame.
        predict = partial(self._predict, known, points, index, around)
        if task.form is Form.NO_FEEDBACK:
            if payload:
                raise BitstreamError("a Wyner-Ziv frame of a stream without feedback is not empty")
            frame = self._decoder.predicted(index, predict())
        else:
            quantization = self._decoder.layout.read_header(payload)
            recorder = PunctureRecorder()
            steps = self._decoder.decode(index, quantization, predict(), *own)
            frame = yield from recorder.watch(steps)
            frame = replace(frame, punctured=recorder.payload(payload[: len(quantization.header)]))
        return replace(frame, decode_s=time.perf_counter() - started)

    def _predict(self, known: Known, points: Points, index: int, around: Around) -> Prediction:
        usable = [known[k] for k in _usable(known, around, self._config.gop.references)]
        with self._predicting:
            found = self._method.predict(usable, points, [index])
        return single_prediction(found, usable[0].frame.luma.shape, self._config.side_information.method)

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


class RecordedGroup:
    """The record of a group of a stream, which answers requests; see `Encoder`."""

    def __init__(self, task: GroupTask, config: CodecConfig) -> None:
        self._task, self._layout, self._coder = task, FrameLayout.of(config), slepian_wolf.plane_coder(config)
        self._answers: dict[int, Answer] = {}  # of frames that are being decoded

    def decode_level(self, rank: Rank, frames: Sequence[FrameCoroutine]) -> list[DecodedFrame]:
        """Decode frames one after the other."""
        del rank
        return [*map(self._drive, frames)]

    def _drive(self, frame: FrameCoroutine) -> DecodedFrame:
        decoded = slepian_wolf.drive(frame, self.answer)
        self._answers.pop(decoded.index, None)
        return decoded

    def answer(self, requests: Round) -> Sequence[Bits]:
        """Answer requests of a frame, whose payload is read once it asks for something."""
        index = requests[0].frame
        if index not in self._answers:
            self._answers[index] = self._source(index)
        return self._answers[index](requests)

    def _source(self, index: int) -> Answer:
        payload = self._task.record.wyner_ziv[index - self._task.first_index]
        if self._task.form is Form.BUFFERED:
            return EncoderBuffer.of(EncodedFrame.read(self._layout, payload), self._coder).answer_round
        return PuncturedFrame(self._layout, payload).answer


def _check_agreement(needed: GopRecord, sent: GopRecord) -> None:
    """Refuse a punctured group that this decoder would have made otherwise."""
    for ours, theirs in zip(needed.wyner_ziv, sent.wyner_ziv, strict=True):
        if len(ours) != len(theirs):
            raise disagreement(f"a Wyner-Ziv frame has {len(theirs)} bytes, {len(ours)} are needed")
    if sent.digest not in (None, needed.digest):
        raise disagreement(f"digest {needed.digest:08x} of the frames, {sent.digest:08x} in the stream")
