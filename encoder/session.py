"""The encoder of figure 5.1: frames in; key frames and parity out, to a file or a live decoder."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import BinaryIO

from dvc.config import CodecConfig
from dvc.errors import VideoError
from dvc.feedback import Connection, EncoderEndpoint, GopDone, ParityRequest
from dvc.keyframes import KeyFrameEncoder
from dvc.stream import GopRecord, StreamWriter
from dvc.tracks import PointTracks, encode_points, encode_tracks
from dvc.video import Frame
from dvc.wynerziv.frame import EncodedFrame
from encoder.block_matching import PointTrackerSettings
from encoder.corners import CornerDetector
from encoder.groups import Group, KeyFrameRule, cornered_groups, groups, tracked_groups
from encoder.tracking import PointTracker, thinned
from encoder.wyner_ziv import WynerZivEncoder

MAX_TRACKS_BPP = 0.01
"""Most bits that tracks cost, per pixel of the Wyner-Ziv frames, unless told otherwise."""

_MIN_TRACKS = 32  # which a group keeps at any cost: cameras have eleven unknowns

Progress = Callable[[int], None]
"""Called with the number of frames that have just been finished."""


@dataclass
class EncoderStatistics:
    """What an encoding run counted.

    Attributes
    ----------
    num_key_frames, num_wyner_ziv_frames : int
        Frames of each type.
    key_cpu_s, wyner_ziv_cpu_s : float
        Processor time spent on the frames of each type, in seconds.
    start_up_cpu_s : float
        Processor time that the first Wyner-Ziv frame took before it was coded again and counted: compiled
        code is loaded when it is first called.
    key_bits, tracks_bits : int
        Bits of all key frames, and of all tracks or points.
    tracking_cpu_s : float
        Processor time spent on corners, tracks and their coding, in seconds.
    num_corners : int
        Corners found.
    num_sad_blocks, num_sad_samples : int
        Blocks compared by the tracker, and samples compared in them.
    num_tracked_frames : int
        Frames that it searched.
    stream_bytes : int
        Size of the stream; 0 in live mode.
    """

    num_key_frames: int = 0
    num_wyner_ziv_frames: int = 0
    key_cpu_s: float = 0.0
    wyner_ziv_cpu_s: float = 0.0
    start_up_cpu_s: float = 0.0
    key_bits: int = 0
    tracks_bits: int = 0
    tracking_cpu_s: float = 0.0
    num_corners: int = 0
    num_sad_blocks: int = 0
    num_sad_samples: int = 0
    num_tracked_frames: int = 0
    stream_bytes: int = 0

    @property
    def num_frames(self) -> int:
        """Frames of both types."""
        return self.num_key_frames + self.num_wyner_ziv_frames


@dataclass
class EncodedGroup:
    """One encoded group of pictures.

    Attributes
    ----------
    key : bytes
        The H.264 picture that ends the group.
    tracks : bytes
        Payload of the tracks or points; empty if there are none.
    frames : list of EncodedFrame
        The Wyner-Ziv frames before it.
    """

    key: bytes
    tracks: bytes = b""
    frames: list[EncodedFrame] = field(default_factory=list)


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
    """

    def __init__(
        self,
        config: CodecConfig,
        rule: KeyFrameRule | None = None,
        max_tracks_bpp: float = MAX_TRACKS_BPP,
        tracking: PointTrackerSettings | None = None,
    ) -> None:
        video, key = config.video, config.key
        self._key_encoder = KeyFrameEncoder(
            video.width, video.height, "lossless" if key.lossless else key.qp, luma_only=video.luma_only
        )
        self.config = replace(config, key=replace(key, parameter_sets=self._key_encoder.parameter_sets))
        self._wyner_ziv_encoder = WynerZivEncoder(self.config)
        self._rule = rule or KeyFrameRule.for_references(config.gop.references)
        self._max_tracks_bpp = max_tracks_bpp
        self._tracker = PointTracker(config.tracks.num_points, config.tracks.subpixel_bits, tracking)
        self._detector = CornerDetector(config.tracks.num_points)
        self._coding_cpu_s = 0.0
        self.statistics = EncoderStatistics()

    def write(self, frames: Iterable[Frame], file: BinaryIO, progress: Progress) -> None:
        """Encode a sequence into the buffered form of a stream.

        Parameters
        ----------
        frames : iterable of Frame
            The sequence; read once, a group of pictures at a time.
        file : binary file
            Where the stream goes.
        progress : callable
            Called with the number of frames just finished.
        """
        writer = StreamWriter(file, self.config, "buffered")
        for group in self.groups(frames):
            encoded = self.encode(group)
            started = time.process_time()
            payloads = tuple(frame.buffered_payload() for frame in encoded.frames)
            self.statistics.wyner_ziv_cpu_s += time.process_time() - started
            writer.write_gop(GopRecord(len(payloads) + 1, encoded.key, encoded.tracks, payloads))
            progress(len(payloads) + 1)
        writer.close()
        self.statistics.stream_bytes = writer.num_bytes

    def serve(self, frames: Iterable[Frame], connection: Connection, progress: Progress) -> None:
        """Encode a sequence for a decoder at the other end of a connection, answering its requests.

        Parameters
        ----------
        frames : iterable of Frame
            The sequence; encoded as the decoder gets to it.
        connection : Connection
            The peer.
        progress : callable
            Called with the number of frames just finished.

        Raises
        ------
        FeedbackError
            If the peer breaks the protocol, falls silent or goes away.
        """
        live = _LiveEncoder(self, frames, connection, progress)
        try:
            live.run()
        except VideoError as err:
            live.give_up(str(err))
            raise

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
        if group.wyner_ziv and not self.statistics.num_wyner_ziv_frames:
            self._start_up(group.wyner_ziv[0])
        started = time.process_time()
        encoded = EncodedGroup(self._key_encoder.encode(group.key))
        between = time.process_time()
        encoded.frames = [self._wyner_ziv_encoder.encode(frame) for frame in group.wyner_ziv]
        self.statistics.key_cpu_s += between - started
        self.statistics.wyner_ziv_cpu_s += time.process_time() - between
        self.statistics.num_key_frames += 1
        self.statistics.num_wyner_ziv_frames += len(encoded.frames)
        self.statistics.key_bits += 8 * len(encoded.key)
        encoded.tracks = self._encode_tracks(group)
        return encoded

    def _start_up(self, frame: Frame) -> None:
        """Code a frame for nothing, so that times of frames are not those of loading code."""
        started = time.process_time()
        self._wyner_ziv_encoder.encode(frame).buffered_payload()
        self.statistics.start_up_cpu_s = time.process_time() - started

    def _encode_tracks(self, group: Group) -> bytes:
        started = time.process_time()
        payload = b""
        if group.tracks is not None:
            payload = self._encode_within_budget(group.tracks)
        elif group.points is not None:
            payload = encode_points(group.points, self.config)
        self._coding_cpu_s += time.process_time() - started
        counts, statistics = self._tracker.counts, self.statistics
        statistics.tracks_bits += 8 * len(payload)
        statistics.tracking_cpu_s = self._coding_cpu_s + counts.cpu_s + self._detector.cpu_s
        statistics.num_corners = counts.num_corners + self._detector.num_corners
        statistics.num_sad_blocks, statistics.num_sad_samples = counts.num_blocks, counts.num_samples
        statistics.num_tracked_frames = counts.num_frames
        return payload

    def _encode_within_budget(self, tracks: PointTracks) -> bytes:
        video = self.config.video
        num_wyner_ziv = tracks.num_instants - 2
        max_bits = self._max_tracks_bpp * video.width * video.height * num_wyner_ziv
        payload = encode_tracks(tracks, self.config)
        while 8 * len(payload) > max_bits and len(tracks) > _MIN_TRACKS:
            count = min(int(0.95 * len(tracks) * max_bits / (8 * len(payload))), len(tracks) - 1)
            tracks = thinned(tracks, max(count, _MIN_TRACKS))
            payload = encode_tracks(tracks, self.config)
        return payload


class _LiveEncoder:
    """The encoder's end of a live run: sends groups while the decoder has room, answers its requests."""

    def __init__(
        self, session: EncoderSession, frames: Iterable[Frame], connection: Connection, progress: Progress
    ) -> None:
        self._session = session
        self._source = session.groups(frames)
        self._connection = connection
        self._progress = progress
        self._endpoint = EncoderEndpoint(session.config)
        self._num_frames = 0
        self._ended = False
        self._open: dict[int, dict[int, EncodedFrame]] = {}

    def run(self) -> None:
        while True:
            while self._endpoint.num_credits and not self._ended:
                self._send_group()
            self._connection.send(self._endpoint.bytes_to_send())
            if self._endpoint.finished:
                return
            for event in self._endpoint.receive(self._connection.receive()):
                if isinstance(event, ParityRequest):
                    self._answer(event)
                elif isinstance(event, GopDone):
                    self._progress(len(self._open.pop(event.number)) + 1)

    def give_up(self, reason: str) -> None:
        self._endpoint.send_failure(reason)
        self._connection.send(self._endpoint.bytes_to_send())

    def _send_group(self) -> None:
        group = next(self._source, None)
        if group is None:
            self._endpoint.send_end()
            self._ended = True
            return
        encoded = self._session.encode(group)
        headers = tuple(frame.header for frame in encoded.frames)
        number = self._endpoint.send_gop(GopRecord(len(headers) + 1, encoded.key, encoded.tracks, headers))
        self._open[number] = dict(enumerate(encoded.frames, self._num_frames))
        self._num_frames += len(headers) + 1

    def _answer(self, request: ParityRequest) -> None:
        frame = next(frames[request.frame] for frames in self._open.values() if request.frame in frames)
        self._endpoint.send_answer(request.frame, request.plane, frame.answer(request))
