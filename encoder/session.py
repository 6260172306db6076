"""The encoder of figure 5.1: frames in; key frames, tracks and parity out."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import BinaryIO

from dvc.config import MAX_TRACKS_BPP, VARIANTS, Allocation, CodecConfig, KeyFrameRule
from dvc.keyframes import KeyFrameEncoder
from dvc.stream import GopRecord, StreamWriter
from dvc.tracks import encode_points
from dvc.video import Frame
from dvc.wynerziv.answers.open_frames import OpenFrames
from dvc.wynerziv.buffered import EncodedFrame
from dvc.wynerziv.hierarchy import reference_distances
from encoder.anchors import KeyFrameSpacing
from encoder.block_matching import PointTrackerSettings
from encoder.clock import coding_time_s
from encoder.corners import CornerDetector
from encoder.groups import Group, cornered_groups, groups, tracked_groups
from encoder.one_way.payloads import OneWayEncoder
from encoder.operations import predicted_positions
from encoder.report import EncoderStatistics
from encoder.track_budget import encode_within_budget
from encoder.tracking import PointTracker
from encoder.wyner_ziv import WynerZivEncoder

Progress = Callable[[int], None]
"""Called with the number of frames that have just been finished."""


@dataclass(frozen=True)
class EncodedGroup:
    """One encoded group of pictures."""

    key: bytes  # the H.264 picture that ends the group; empty where its last frame is a Wyner-Ziv frame, too
    tracks: bytes  # payload of the tracks or points; empty if there are none
    frames: tuple[EncodedFrame, ...]  # the Wyner-Ziv frames
    one_way: tuple[bytes, ...] = ()  # their payloads where no decoder asks for bits

    def record(self, wyner_ziv: Iterable[bytes]) -> GopRecord:
        """Return the record of the group."""
        num_frames = len(self.frames) + bool(self.key)
        return GopRecord(num_frames, self.key, self.tracks, tuple(wyner_ziv))


class EncoderSession:
    """Encodes one sequence.

    Parameters
    ----------
    config : CodecConfig
        Configuration; the key frames' parameter sets are filled in here.
    rule : KeyFrameRule, optional
        When tracks ask for a key frame.
    max_tracks_bpp : float, optional
        Bits of tracks that a Wyner-Ziv frame may cost, per pixel; a group with more of them keeps the best.
    tracking : PointTrackerSettings, optional
        How points are followed.
    allocation : Allocation, optional
        Tells the steps of nested bins, where the configuration has them.
    margin_percent : int, optional
        What is sent beyond the need that is expected, where no decoder asks for it; else everything is.
    """

    def __init__(
        self,
        config: CodecConfig,
        rule: KeyFrameRule | None = None,
        max_tracks_bpp: float = MAX_TRACKS_BPP,
        tracking: PointTrackerSettings | None = None,
        allocation: Allocation | None = None,
        margin_percent: int | None = None,
    ) -> None:
        video, key = config.video, config.key
        self._key_encoder = KeyFrameEncoder(
            video.width,
            video.height,
            "lossless" if key.lossless else key.qp,
            luma_only=video.luma_only,
            quick=margin_percent is not None,
        )
        self.config = replace(config, key=replace(key, parameter_sets=self._key_encoder.parameter_sets))
        self._wyner_ziv_encoder = WynerZivEncoder(self.config, lazily=margin_percent is not None)
        self._one_way = None if margin_percent is None else OneWayEncoder(self.config, margin_percent)
        self._allocation = allocation
        self._key_frames = KeyFrameSpacing(config.gop, feedback=margin_percent is None)
        self._rule = rule or VARIANTS[config.codec].groups(config.gop.references).key_frames
        self._max_tracks_bpp = max_tracks_bpp
        self._tracker = PointTracker(config.tracks.num_points, config.tracks.subpixel_bits, tracking)
        self._detector = CornerDetector(config.tracks.num_points)
        self._tracks_cpu_s = 0.0
        self.statistics = EncoderStatistics()

    def write(self, frames: Iterable[Frame], file: BinaryIO, progress: Progress) -> None:
        """Encode a sequence into a stream: of the buffered form, or one-way where no decoder asks.

        Parameters
        ----------
        frames : iterable of Frame
            The sequence; read once, a group of pictures at a time.
        file : binary file
            Where the stream goes.
        progress : callable
            Called with the number of frames just finished.
        """
        statistics = self.statistics
        with statistics.coding():
            writer = StreamWriter(file, self.config, "one-way" if self._one_way else "buffered")
            for group in self.groups(frames):
                encoded = self.encode(group)
                payloads = encoded.one_way
                if self._one_way is None:
                    with statistics.timing("parity_cpu_s"):
                        payloads = tuple(frame.buffered_payload() for frame in encoded.frames)
                with statistics.timing("writing_cpu_s"):
                    record = encoded.record(payloads)
                    writer.write_gop(record)
                progress(record.num_frames)
            with statistics.timing("writing_cpu_s"):
                writer.close()
        statistics.stream_bytes = writer.num_bytes

    def groups(self, frames: Iterable[Frame]) -> Iterator[Group]:
        """Cut the sequence into groups of pictures as the configuration says.

        Parameters
        ----------
        frames : iterable of Frame
            The sequence.

        Returns
        -------
        iterator of Group
            See `encoder.groups`.
        """
        length, kind = self.config.gop.length, self.config.tracks.kind
        frames = self.statistics.reading(frames)
        if kind == "encoder" and length > 1:
            return tracked_groups(frames, length, self._tracker, self._rule)
        if kind == "decoder":
            return cornered_groups(frames, length, self._detector)
        return groups(frames, length)

    def encode(self, group: Group) -> EncodedGroup:
        """Encode one group of pictures.

        Parameters
        ----------
        group : Group
            Original frames.

        Returns
        -------
        EncodedGroup
            Key frame and Wyner-Ziv frames; parity is computed when it is needed.
        """
        statistics, wyner_ziv = self.statistics, self._wyner_ziv_encoder
        anchored = not self._key_frames.needs_key(group)
        originals = (*group.wyner_ziv, group.key) if anchored else group.wyner_ziv
        steps = self._steps(len(originals), anchored)
        with statistics.timing("key_cpu_s"):
            key = b"" if anchored else self._key_encoder.encode(group.key)
        with statistics.timing("transform_cpu_s"):
            frames = wyner_ziv.encode_group(originals, steps)
        one_way: tuple[bytes, ...] = ()
        if self._one_way is not None:
            with statistics.timing("one_way_cpu_s"):
                one_way = self._one_way.payloads(group, frames)
            statistics.set_one_way(self._one_way.work)
        tracks = self._encode_tracks(group)
        statistics.add_group(frames, key, tracks)
        return EncodedGroup(key, tracks, frames, one_way)

    def open_frames(self, num_slots: int) -> OpenFrames:
        """Return what answers a live decoder.

        Parameters
        ----------
        num_slots : int
            Frames that may be open at a time.

        Returns
        -------
        OpenFrames
            Without any frame.
        """
        return self._wyner_ziv_encoder.open_frames(num_slots)

    def _steps(self, num_frames: int, anchored: bool) -> list[float]:
        """Return the width of nested bins of each Wyner-Ziv frame of a group."""
        if self._allocation is None:
            return [1.0] * num_frames
        gop = self.config.gop
        anchor_distance = gop.anchor_distance if anchored else 0
        distances = reference_distances(num_frames, gop.references != "keys", anchor_distance)
        return [self._allocation.step(distance) for distance in distances]

    def _encode_tracks(self, group: Group) -> bytes:
        started = coding_time_s()
        payload = b""
        if group.tracks is not None:
            payload = encode_within_budget(group.tracks, self.config, self._max_tracks_bpp)
            self.statistics.num_positions += predicted_positions(group.tracks)
        elif group.points is not None:
            payload = encode_points(group.points, self.config)
        self._tracks_cpu_s += coding_time_s() - started
        self.statistics.set_tracking(self._tracker.counts, self._detector, self._tracks_cpu_s)
        return payload
