"""The encoder of figure 5.1: frames in; key frames, tracks and parity out."""

import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby
from typing import BinaryIO, cast

from dvc.config import MAX_TRACKS_BPP, VARIANTS, CodecConfig, Delivery, KeyFrameRule, NoFeedback, ParityBuffer
from dvc.keyframes import KeyFrameEncoder, KeyPicture
from dvc.stream import Form, GopRecord, StreamWriter
from dvc.tracks import encode_points
from dvc.video import Frame
from dvc.wynerziv.encoder_buffer import EncoderBuffer
from dvc.wynerziv.hierarchy import reference_distances
from dvc.wynerziv.payloads import EncodedFrame
from encoder.bitrate import QualityStep
from encoder.block_matching import PointTrackerSettings
from encoder.clock import coding_time_s
from encoder.corners import CornerDetector
from encoder.groups import Group, cornered_groups, groups, tracked_groups
from encoder.operations import predicted_positions
from encoder.rate_limiter import FrameCoders, RateLimiter, limited
from encoder.rate_limits import RateLimits
from encoder.report import EncoderStatistics
from encoder.spacing import Spacing
from encoder.time_stamps import CodingClock
from encoder.track_budget import encode_within_budget, worthwhile
from encoder.tracking import PointTracker
from encoder.wyner_ziv import wyner_ziv_encoder

Progress = Callable[[int], None]
"""Called with the number of frames that have just been finished."""


@dataclass(frozen=True)
class EncodedGroup:
    """One encoded group of pictures."""

    record: GopRecord
    frames: tuple[EncodedFrame, ...]  # the Wyner-Ziv frames


class EncoderSession:
    """Encodes one sequence.

    Parameters
    ----------
    config : CodecConfig
        Configuration; the key frames' parameter sets are filled in here.
    delivery : Delivery, optional
        How the decoder gets what it needs; a file with all parity by default.
    rule : KeyFrameRule, optional
        When tracks ask for a key frame; as suits codec and delivery by default.
    max_tracks_bpp : float, optional
        Bits of tracks that a Wyner-Ziv frame may cost, per pixel; a group with more of them keeps the best.
    tracking : PointTrackerSettings, optional
        How points are followed.
    clock : CodingClock, optional
        What time stamps of the frames are compared with, where other sessions coded those before.
    limits : RateLimits, optional
        What the stream may take; quality is constant by default.

    Raises
    ------
    ConfigError
        If there are limits, and all parity is stored, or quantisers are not embedded.
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
        delivery, limits = delivery or ParityBuffer(), limits or RateLimits()
        config = limited(config, delivery, limits)
        self._wyner_ziv_encoder = wyner_ziv_encoder(config, delivery)
        self.statistics = EncoderStatistics()
        self.limiter: RateLimiter | None = None
        if not limits.is_none:
            coders = FrameCoders(self._code_key, self._code_wyner_ziv)
            self.limiter = RateLimiter(config, delivery, limits, coders)
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
        groups = VARIANTS[config.codec].groups(config.gop.references, config.key.intra_period)
        self._rule = rule or groups.key_frames
        self._max_tracks_bpp = max_tracks_bpp
        tracks, work = config.tracks, self.statistics.tracking
        self._tracker = PointTracker(tracks.num_points, tracks.subpixel_bits, tracking, work)
        self._spacing = Spacing(work) if isinstance(delivery, NoFeedback) else None
        self._detector = CornerDetector(tracks.num_points, work=work)
        self._num_groups = 0
        self._num_chained = 0  # frames since the last IDR picture; 0 if the next key frame is one
        self._clock = clock or CodingClock(config.video.frame_rate)
        self._clock.begin_stream()

    def write(self, frames: Iterable[Frame | None], file: BinaryIO, progress: Progress) -> None:
        """Encode a sequence into a stream, of the form that suits its delivery.

        Parameters
        ----------
        frames : iterable of Frame or None
            The sequence, as for `groups`; read once, a group of pictures at a time.
        file : binary file
            Where the stream goes.
        progress : callable
            Called with the number of frames just finished.
        """
        statistics = self.statistics
        with statistics.coding():
            encoder = self._wyner_ziv_encoder
            form = Form.NO_FEEDBACK if encoder is None else encoder.form
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
        """Cut the sequence into groups of pictures as the configuration says.

        Parameters
        ----------
        frames : iterable of Frame or None
            The sequence; None where frames were left out, after which groups begin anew.

        Yields
        ------
        Group
            See `encoder.groups`.
        """
        for is_frames, run in groupby(self.statistics.reading(frames), lambda frame: frame is not None):
            if is_frames:
                yield from self._groups_of_run(cast("Iterator[Frame]", run))

    def _groups_of_run(self, frames: Iterator[Frame]) -> Iterator[Group]:
        length, kind = self.config.gop.length, self.config.tracks.kind
        if kind == "encoder" and length > 1:
            return tracked_groups(frames, length, self._tracker, self._rule, self._spacing)
        if kind == "decoder":
            return cornered_groups(frames, length, self._detector)
        return groups(frames, length)

    def begin_again(self, number: int) -> None:
        """Begin a chain of key frames with a group, so that a decoder can begin there.

        Parameters
        ----------
        number : int
            Of the group, whose key frame becomes an IDR picture if it is still to be encoded.
        """
        if number >= self._num_groups:
            self._num_chained = 0

    def encode(self, group: Group) -> EncodedGroup:
        """Encode one group of pictures.

        Parameters
        ----------
        group : Group
            Original frames.

        Returns
        -------
        EncodedGroup
            Its record, and the Wyner-Ziv frames, of which a live decoder may ask for more.
        """
        statistics, wyner_ziv = self.statistics, self._wyner_ziv_encoder
        tracks = self._encode_tracks(group) if group.wyner_ziv else b""
        begins_chain = self._begins_chain(group)
        if self.limiter is not None:
            key, qp, frames, allowed = self.limiter.code(group, begins_chain, 8 * len(tracks))
        else:
            key, qp = self._code_key(group.key, begins_chain), self.config.key.qp
            frames, allowed = self._code_wyner_ziv(group), ()
        with statistics.timing("parity_cpu_s"):
            empty = (b"",) * len(group.wyner_ziv)
            payloads = empty if wyner_ziv is None else wyner_ziv.payloads(frames)
        if allowed:
            payloads = tuple(map(operator.add, payloads, allowed))
        deviations = self._clock.deviations((*group.wyner_ziv, group.key))
        record = GopRecord(
            len(payloads) + 1, key.data, key.predicted, tracks, payloads, deviations=deviations
        )
        if self._spacing is not None:
            self._spacing.learn(key, qp, record.num_frames if self.config.key.predicted else 0)
        self._num_groups += 1
        self._num_chained = self._num_chained + record.num_frames if key.predicted else 1
        statistics.add_group(frames, record)
        return EncodedGroup(record, frames)

    def _begins_chain(self, group: Group) -> bool:
        """Decide whether the key frame of a group is an IDR picture."""
        num_chained = self._num_chained + len(group.wyner_ziv) + 1
        return not self._num_chained or group.begins_scene or num_chained > self.config.key.intra_period

    def _code_key(self, frame: Frame, begins_chain: bool, qp: int | None = None) -> KeyPicture:
        with self.statistics.timing("key_cpu_s"):
            return self._key_encoder.encode(frame, qp, begins_chain=begins_chain)

    def _code_wyner_ziv(self, group: Group, quality: QualityStep | None = None) -> tuple[EncodedFrame, ...]:
        """Transform the Wyner-Ziv frames of a group."""
        if self._wyner_ziv_encoder is None:
            return ()
        originals, wyner_ziv = group.wyner_ziv, self.config.wyner_ziv
        distances = reference_distances(len(originals), self.config.gop.references != "keys")
        steps = [*map(cache(wyner_ziv.step), distances)]
        if quality is not None:
            steps = quality.steps(wyner_ziv, distances)
        with self.statistics.timing("transform_cpu_s"):
            return self._wyner_ziv_encoder.encode_group(originals, steps)

    def encoder_buffer(self, num_slots: int) -> EncoderBuffer:
        """Return what answers a live decoder.

        Parameters
        ----------
        num_slots : int
            Frames that may be open at a time.

        Returns
        -------
        EncoderBuffer
            Without any frame.
        """
        assert self._wyner_ziv_encoder is not None
        return self._wyner_ziv_encoder.encoder_buffer(num_slots)

    def _encode_tracks(self, group: Group) -> bytes:
        started = coding_time_s()
        payload = b""
        if group.tracks is not None:
            tracks = worthwhile(group.tracks, self.config)
            payload = encode_within_budget(tracks, self.config, self._max_tracks_bpp)
            self.statistics.tracking.num_positions += predicted_positions(tracks)
        elif group.points is not None:
            payload = encode_points(group.points, self.config)
        self.statistics.tracking.cpu_s += coding_time_s() - started
        return payload
