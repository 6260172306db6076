"""Decoding of the Wyner-Ziv frames of one group of pictures between decoded key frames."""

import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from decoder.frame_state import Learned
from decoder.group_tasks import Bits, DecodedFrame, DecodedGroup, GroupTask
from decoder.side_information.methods import METHODS
from decoder.side_information.protocol import Prediction, ReferenceFrame
from decoder.wyner_ziv import Allowance, WynerZivDecoder, decode_level
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
Rank = tuple[int, int]
"""Levels that follow, negative, and the number of the group: the lowest comes first."""
MAX_LEVEL_PX = 2**21
"""Pixels of frames that are decoded in step, if they are more than one: each takes memory until all end."""


class LevelBegins(NamedTuple):
    """Start of the decoding of frames, once enough memory is free."""

    rank: Rank
    frames: tuple[int, ...]  # display positions
    num_px: int  # pixels of all of them


@dataclass(frozen=True)
class PlannedFrame:
    """A frame that is decoded next."""

    index: int  # display position
    around: Around  # its references
    learned: Learned
    allowance: Allowance  # bits that it may request


@dataclass(frozen=True)
class _GroupState:
    """A group that is being decoded."""

    task: GroupTask
    points: Points
    decoded: dict[int, ReferenceFrame]  # by display position


GroupCoroutine = Generator[Round | LevelBegins, Sequence[Bits], DecodedGroup]
"""Yields requests and receives their bits; receives nothing at the start of a level."""


def single_prediction(result: object, shape: tuple[int, ...], method: str) -> Prediction:
    """Check and return the prediction of one frame, since plug-in methods may return anything."""
    named = f"side information {method!r}"
    if not isinstance(result, Sequence) or len(result) != 1 or not isinstance(result[0], Prediction):
        raise DvcError(f"{named}: expected a list of one prediction for one instant")
    prediction: Prediction = result[0]
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


HEADROOM = 1.25
"""Factor on the share of the remaining bits that a level may request if further levels follow."""


class GroupAllowance:
    """Bits that the frames of a group may still request."""

    def __init__(self, stated_bits: Mapping[int, int] | None) -> None:
        # Limits of frames that are not decoded yet, as the encoder states them; None without limits.
        self._stated = None if stated_bits is None else dict(stated_bits)
        self._left = 0.0 if stated_bits is None else float(sum(stated_bits.values()))

    def begin_level(self, frames: Sequence[int]) -> list[Allowance]:
        """Return the allowances of frames that are decoded side by side."""
        if self._stated is None:
            return [Allowance() for _ in frames]
        whole = sum(self._stated.values())
        stated = [self._stated.pop(frame) for frame in frames]
        headroom = min(HEADROOM * sum(stated), whole) / max(sum(stated), 1)
        per_bit = headroom * max(self._left, 0.0) / max(whole, 1)
        return [Allowance(per_bit * bits) for bits in stated]

    def end_level(self, num_bits: int) -> None:
        """Subtract the bits that a level requested."""
        self._left -= num_bits


class GroupDecoder:
    """Decodes groups of pictures of one configuration."""

    def __init__(self, config: CodecConfig, frames: WynerZivDecoder | None = None) -> None:
        method = config.side_information.method
        if method not in METHODS:
            raise BitstreamError(METHODS.missing(repr(method)))
        self._config = config
        self._method = METHODS[method](config)
        self._decoder = frames or WynerZivDecoder(config)

    def decode(self, task: GroupTask) -> DecodedGroup:
        """Decode a group with a record that answers."""
        return slepian_wolf.drive(self.steps(task), RecordedGroup(task, self._config).answer)

    def steps(self, task: GroupTask) -> GroupCoroutine:
        """Decode a group as a coroutine that yields requests."""
        if not task.record.wyner_ziv:
            return DecodedGroup.of(task, [])
        if task.before is None:
            raise BitstreamError("Wyner-Ziv frames without a frame before them")
        config, layout = self._config, self._decoder.layout
        keys = task.before, ReferenceFrame(task.last_index, task.key)
        points: Points = None
        tracks, num_frames = task.record.tracks, task.record.num_frames - 1
        if tracks:
            if config.tracks.kind == "none":
                raise BitstreamError("tracks in a stream with a configuration without tracks")
            if config.tracks.kind == "encoder":
                points = decode_tracks(tracks, num_frames + 2, config)
            else:
                points = decode_points(tracks, num_frames, config)
        state = _GroupState(task, points, {key.index: key for key in keys})
        order = decoding_order(task.first_index - 1, task.last_index, config.gop.references != "keys")
        ordered = [[frame] for frame in order] if config.gop.references == "all" else levels(order)
        stated_bits = None
        if layout.limited:
            headers = map(layout.read_header, task.record.wyner_ziv)
            stated_bits = {
                index: header.told_bits or 0 for index, header in enumerate(headers, task.first_index)
            }
        frames: list[DecodedFrame] = []
        learned, allowance = self._decoder.nothing_learned(), GroupAllowance(stated_bits)
        frame_px = config.video.width * config.video.height
        in_step = max(MAX_LEVEL_PX // frame_px, 1) if self._decoder.coder.by_positions else 1
        for levels_left, level in zip(range(len(ordered), 0, -1), ordered, strict=True):
            allowed = allowance.begin_level([index for index, _ in level])
            planned = [
                PlannedFrame(index, around, learned.copy(), bits)
                for (index, around), bits in zip(level, allowed, strict=True)
            ]
            decoded: list[DecodedFrame] = []
            for first in range(0, len(planned), in_step):
                part = planned[first : first + in_step]
                indices = tuple(frame.index for frame in part)
                yield LevelBegins((-levels_left, task.number), indices, len(indices) * frame_px)
                if task.form is Form.NO_FEEDBACK:
                    decoded += [self._predicted(state, frame) for frame in part]
                else:
                    decoded += yield from self._requested(state, part)
            learned = learned.joined([frame.learned for frame in planned])
            allowance.end_level(sum(frame.crc_bits + frame.parity_bits for frame in decoded))
            state.decoded.update({frame.index: ReferenceFrame(frame.index, frame.frame) for frame in decoded})
            frames += decoded
        group = DecodedGroup.of(task, sorted(frames, key=lambda frame: frame.index))
        if task.form is Form.PUNCTURED:
            _check_agreement(group.record, task.record)
        return group

    def _predicted(self, state: _GroupState, frame: PlannedFrame) -> DecodedFrame:
        """Return a frame that consists of its prediction."""
        started = time.perf_counter()
        if state.task.record.wyner_ziv[frame.index - state.task.first_index]:
            raise BitstreamError("a Wyner-Ziv frame of a stream without feedback is not empty")
        decoded = self._decoder.predicted(frame.index, self._predict(state, frame))
        return replace(decoded, decode_s=time.perf_counter() - started)

    def _requested(
        self, state: _GroupState, part: Sequence[PlannedFrame]
    ) -> Generator[Round, Sequence[Bits], list[DecodedFrame]]:
        """Decode frames in step; the payload of the first one holds the requested bits."""
        started, layout, coder = time.perf_counter(), self._decoder.layout, self._decoder.coder
        headers, coroutines = [], {}
        for frame in part:
            payload = state.task.record.wyner_ziv[frame.index - state.task.first_index]
            quantization = layout.read_header(payload)
            headers.append(payload[: len(quantization.header)])
            # No variable holds the prediction: its planes take as much memory as all else of a frame.
            coroutines[frame.index] = self._decoder.decode(
                frame.index, quantization, self._predict(state, frame), frame.learned, frame.allowance
            )
        predict_s = (time.perf_counter() - started) / len(part)
        recorder = PunctureRecorder()
        steps = decode_level(coroutines, coder.decoder(layout.num_bits), coder.by_positions)
        frames = yield from recorder.watch(steps)
        payloads = [recorder.payload(headers[0]), *headers[1:]]
        left = 8 * sum(map(len, payloads)) - sum(frame.crc_bits + frame.parity_bits for frame in frames)
        header_bits = [left - 8 * sum(map(len, headers[1:])), *(8 * len(own) for own in headers[1:])]
        return [
            replace(frame, punctured=payload, header_bits=bits, decode_s=frame.decode_s + predict_s)
            for frame, payload, bits in zip(frames, payloads, header_bits, strict=True)
        ]

    def _predict(self, state: _GroupState, frame: PlannedFrame) -> Prediction:
        """Predict a frame from all decoded ones, or from key frames and those around it."""
        decoded = state.decoded
        if self._config.gop.references != "all":
            decoded = {index: decoded[index] for index in {min(decoded), *frame.around, max(decoded)}}
        references = [decoded[index] for index in sorted(decoded)]
        result = self._method.predict(references, state.points, [frame.index])
        shape = references[0].frame.luma.shape
        return single_prediction(result, shape, self._config.side_information.method)


class RecordedGroup:
    """The record of a group of a stream, which answers requests."""

    def __init__(self, task: GroupTask, config: CodecConfig) -> None:
        self._task, self._layout, self._coder = task, FrameLayout.of(config), slepian_wolf.plane_coder(config)
        self._level: tuple[int, ...] = ()  # frames that are decoded now
        self._source: Answer | None = None

    def answer(self, asked: Round | LevelBegins) -> Sequence[Bits]:
        """Answer requests of a level; its payloads are read at the first request."""
        if isinstance(asked, LevelBegins):
            self._level, self._source = asked.frames, None
            return ()
        if self._source is None:
            task, first = self._task, min(self._level)
            payloads = {index: task.record.wyner_ziv[index - task.first_index] for index in self._level}
            if task.form is not Form.BUFFERED:
                self._source = PuncturedFrame(self._layout, payloads[first]).answer
            else:
                buffer = EncoderBuffer(self._layout, self._coder, max(self._level) - first + 1)
                for index, payload in payloads.items():
                    buffer.enter(index - first, EncodedFrame.read(self._layout, payload))
                self._source = partial(buffer.answer_round, first_frame=first)
        return self._source(asked)


def _check_agreement(needed: GopRecord, sent: GopRecord) -> None:
    """Refuse a punctured group that this decoder would have made otherwise."""
    for ours, theirs in zip(needed.wyner_ziv, sent.wyner_ziv, strict=True):
        if len(ours) != len(theirs):
            raise disagreement(f"a Wyner-Ziv frame has {len(theirs)} bytes, {len(ours)} are needed")
    if sent.digest not in (None, needed.digest):
        raise disagreement(f"digest {needed.digest:08x} of the frames, {sent.digest:08x} in the stream")
