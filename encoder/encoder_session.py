"""Encoder of figure 5.1: frames in; key frames, tracks and bit planes out."""

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from itertools import groupby
from typing import BinaryIO, cast

from dvc.config import (
    MAX_TRACKS_BPP,
    VARIANTS,
    CodecConfig,
    Delivery,
    KeyFrameRule,
    Live,
    NoFeedback,
    ParityBuffer,
)
from dvc.keyframes import KeyFrameEncoder, KeyPicture
from dvc.slepian_wolf.requests import drive
from dvc.stream import MAX_DEVIATION_TICKS, Deviations, Form, GopRecord, StreamWriter, planned_tick
from dvc.video import Frame
from dvc.wynerziv.hierarchy import reference_distances
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.quantizer import FrameLayout
from encoder.encoder_report import EncoderStatistics, coding_time_s
from encoder.groups import CornerGroups, FixedGroups, Group, TrackedGroups
from encoder.leaky_bucket import QualityStep
from encoder.point_tracker import PointTracker, PointTrackerSettings
from encoder.rate_limiter import CodedFrames, CodeKey, Coding, RateLimiter
from encoder.rate_limits import RateLimits
from encoder.spacing import Spacing

Progress = Callable[[int], None]
"""Function that is called with the number of frames that have just been finished."""


class CodingClock:
    """Compares the time stamps of the source with the number of coded frames before each."""

    def __init__(self, frame_rate: Fraction) -> None:
        self._interval_s = 1 / frame_rate
        self._ticks_per_second = 0  # clock of the source; 0 without one
        self._ticks_per_frame = Fraction(0)
        self._num_frames = 0  # coded in the stream
        self._zero: int | None = None  # tick of the source that is tick 0 of the stream
        self._last = 0  # tick of the stream when the last frame is shown

    def begin_stream(self) -> None:
        """Start a stream at the next frame; it continues the clock of the last one."""
        if self._zero is not None:
            self._zero += self._last - planned_tick(-1, self._ticks_per_frame)
        self._num_frames = 0

    def deviations(self, frames: Sequence[Frame]) -> Deviations | None:
        """Return the delay of each of the next frames; None if all are less than a tick off."""
        if not self._ticks_per_second:  # unless it is too coarse to separate frames
            clocks = (frame.time.ticks_per_second for frame in frames if frame.time is not None)
            self._ticks_per_second = next((fine for fine in clocks if fine * self._interval_s >= 1), 0)
            self._ticks_per_frame = self._ticks_per_second * self._interval_s
        first, self._num_frames = self._num_frames, self._num_frames + len(frames)
        if not self._ticks_per_second:
            return None
        numbers = range(first, self._num_frames)
        ticks = [self._tick(number, frame) for number, frame in zip(numbers, frames, strict=True)]
        length, unit = self._ticks_per_frame.as_integer_ratio()
        if all(abs(unit * tick - length * n) < unit for n, tick in zip(numbers, ticks, strict=True)):
            return None
        planned = (planned_tick(number, self._ticks_per_frame) for number in numbers)
        return Deviations(self._ticks_per_second, tuple(map(operator.sub, ticks, planned)))

    def _tick(self, number: int, frame: Frame) -> int:
        """Return the tick of a frame; if the clock of the source jumps, the usual interval after the last."""
        planned, before = (planned_tick(n, self._ticks_per_frame) for n in (number, number - 1))
        if number == 0 or self._zero is None:
            self._last = before
        usual = planned + self._last - before
        tick = usual
        if frame.time is not None:
            now, clock = frame.time
            if clock != self._ticks_per_second:
                now = round(frame.time.seconds * self._ticks_per_second)
            zero = now - usual if self._zero is None else self._zero
            if now - zero <= self._last or abs(now - zero - planned) > MAX_DEVIATION_TICKS:
                zero = now - usual
            self._zero, tick = zero, now - zero
        self._last = tick
        return tick


@dataclass(frozen=True)
class EncodedGroup:
    """One encoded group of pictures."""

    record: GopRecord
    frames: tuple[EncodedFrame, ...]  # Wyner-Ziv frames


class EncoderSession:
    """Encodes one sequence.

    Parameters
    ----------
    config : CodecConfig
        Configuration; the key frames' parameter sets are filled in here.
    delivery : Delivery, optional
        Delivery of the bit planes; a file with all of them by default.
    rule : KeyFrameRule, optional
        Conditions under which tracks end a group; those of the variant by default.
    max_tracks_bpp : float, optional
        Largest number of bits of tracks per pixel of a Wyner-Ziv frame; the best tracks are kept.
    tracking : PointTrackerSettings, optional
        Settings of the tracker.
    clock : CodingClock, optional
        Clock of the earlier frames, if other sessions coded these.
    limits : RateLimits, optional
        Limits of the stream; constant quality by default.

    Raises
    ------
    ConfigError
        If the stream has limits, and all planes are stored or the quantisers are not embedded.
    """

    def __init__(
        self,
        config: CodecConfig,
        delivery: Delivery | None = None,
        rule: KeyFrameRule | None = None,
        max_tracks_bpp: float = MAX_TRACKS_BPP,
        tracking: PointTrackerSettings | None = None,
        clock: CodingClock | None = None,
        limits: RateLimits | None = None,
    ) -> None:
        delivery = delivery or ParityBuffer()
        self.statistics = EncoderStatistics()
        self.limiter: RateLimiter | None = None
        if limits is not None:  # headers state the limits to a live decoder
            wyner_ziv = replace(config.wyner_ziv, limited=isinstance(delivery, Live))
            config = replace(config, wyner_ziv=wyner_ziv)
            self.limiter = RateLimiter(config, delivery, limits)
        self._delivery = delivery
        self._layout = None if isinstance(delivery, NoFeedback) else FrameLayout.of(config)
        self._key_encoder = KeyFrameEncoder(
            config.video.width,
            config.video.height,
            "lossless" if config.key.lossless else config.key.qp,
            luma_only=config.video.luma_only,
            predicted=config.key.predicted,
            chroma_qp_offset=0 if isinstance(delivery, NoFeedback) else None,
        )
        self.config = replace(
            config, key=replace(config.key, parameter_sets=self._key_encoder.parameter_sets)
        )
        self._spacing: Spacing | None = None
        self._group_coder = FixedGroups(config.gop.length)
        tracks, work = config.tracks, self.statistics.tracking
        if tracks.kind == "decoder":
            self._group_coder = CornerGroups(config, work)
        elif tracks.kind == "encoder" and config.gop.length > 1:
            if isinstance(delivery, NoFeedback):
                self._spacing = Spacing(work)
            preset = VARIANTS[config.codec].groups(config.gop.references, config.key.intra_period)
            tracker = PointTracker(tracks.num_points, tracks.subpixel_bits, tracking, work)
            rule = rule or preset.key_frames
            self._group_coder = TrackedGroups(config, rule, max_tracks_bpp, tracker, self._spacing)
        self._num_chained = 0  # frames since the last IDR picture; 0 if the next key frame is one
        self._clock = clock or CodingClock(config.video.frame_rate)
        self._clock.begin_stream()

    def write(self, frames: Iterable[Frame | None], file: BinaryIO, progress: Progress) -> None:
        """Encode a sequence as `groups` reads it into a stream of the form of its delivery."""
        statistics = self.statistics
        with statistics.coding():
            form = Form.NO_FEEDBACK if self._layout is None else Form.BUFFERED
            writer = StreamWriter(file, self.config, form)
            for group in self.groups(frames):
                record = self.encode(group).record
                with statistics.timing("writing_cpu_s"):
                    writer.write_gop(record)
                progress(record.num_frames)
            with statistics.timing("writing_cpu_s"):
                writer.close()
        statistics.stream_bytes = writer.num_bytes

    def groups(self, frames: Iterable[Frame | None]) -> Iterator[Group]:
        """Yield the groups of a sequence, read once; None marks dropped frames, and a new group follows."""
        for is_frames, run in groupby(self.statistics.reading(frames), lambda frame: frame is not None):
            if is_frames:
                yield from self._group_coder.groups(cast("Iterator[Frame]", run))

    def encode(self, group: Group) -> EncodedGroup:
        """Encode one group of pictures."""
        statistics, wyner_ziv = self.statistics, group.wyner_ziv
        started = coding_time_s()
        tracks = self._group_coder.payload(group) if wyner_ziv else b""
        statistics.tracking.cpu_s += coding_time_s() - started
        num_chained = self._num_chained + len(wyner_ziv) + 1
        is_late = not self._num_chained or num_chained > self.config.key.intra_period
        begins_chain = group.begins_scene or is_late  # the key frame becomes an IDR picture
        if self.limiter is None:
            key = self._code_key(group.key, begins_chain)
            coded = CodedFrames(key, self.config.key.qp, self._code_wyner_ziv(group))
        else:

            def code(coding: Coding) -> KeyPicture | tuple[EncodedFrame, ...]:
                if isinstance(coding, CodeKey):
                    return self._code_key(group.key, coding.begins_chain, coding.qp)
                return self._code_wyner_ziv(group, coding)

            coded = drive(self.limiter.plan(group, begins_chain, 8 * len(tracks)), code)
        key, frames = coded.key, coded.wyner_ziv
        with statistics.timing("parity_cpu_s"):
            payloads = (b"",) * len(wyner_ziv)
            if isinstance(self._delivery, Live):
                payloads = tuple(frame.header for frame in frames)
            elif frames:
                payloads = tuple(frame.buffered_payload() for frame in frames)
        if coded.limits:
            payloads = tuple(map(operator.add, payloads, coded.limits))
        deviations = self._clock.deviations((*wyner_ziv, group.key))
        record = GopRecord(
            len(payloads) + 1, key.data, key.predicted, tracks, payloads, deviations=deviations
        )
        if self._spacing is not None:
            self._spacing.update(key, coded.qp, record.num_frames if self.config.key.predicted else 0)
        self._num_chained = self._num_chained + record.num_frames if key.predicted else 1
        statistics.add_group(frames, record)
        return EncodedGroup(record, frames)

    def _code_key(self, frame: Frame, begins_chain: bool, qp: int | None = None) -> KeyPicture:
        with self.statistics.timing("key_cpu_s"):
            return self._key_encoder.encode(frame, qp, begins_chain=begins_chain)

    def _code_wyner_ziv(self, group: Group, quality: QualityStep | None = None) -> tuple[EncodedFrame, ...]:
        """Transform and quantise the Wyner-Ziv frames of a group."""
        if self._layout is None:
            return ()
        wyner_ziv = self.config.wyner_ziv
        distances = reference_distances(len(group.wyner_ziv), self.config.gop.references != "keys")
        steps = [*map(cache(wyner_ziv.step), distances)]
        if quality is not None:
            steps = quality.steps(wyner_ziv, distances)
        with self.statistics.timing("transform_cpu_s"):
            pairs = zip(group.wyner_ziv, steps, strict=True)
            return tuple(EncodedFrame.of(self._layout, frame.luma, step) for frame, step in pairs)
