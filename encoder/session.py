"""The encoder of figure 5.1: frames in; key frames and parity out, into a file or to a decoder that asks for it."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import BinaryIO

from dvc.config import CodecConfig
from dvc.feedback import Connection, EncoderEndpoint, GopDone, ParityRequest
from dvc.keyframes import KeyFrameEncoder
from dvc.stream import GopRecord, StreamWriter
from dvc.video import Frame
from dvc.wynerziv.frame import EncodedFrame
from encoder.groups import Group, groups
from encoder.wyner_ziv import WynerZivEncoder

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
    key_bits : int
        Bits of all key frames.
    stream_bytes : int
        Size of the stream; 0 in live mode.
    """

    num_key_frames: int = 0
    num_wyner_ziv_frames: int = 0
    key_cpu_s: float = 0.0
    wyner_ziv_cpu_s: float = 0.0
    key_bits: int = 0
    stream_bytes: int = 0

    @property
    def num_frames(self) -> int:
        """Frames of both types."""
        return self.num_key_frames + self.num_wyner_ziv_frames


@dataclass
class _EncodedGroup:
    key: bytes
    frames: list[EncodedFrame] = field(default_factory=list)


class EncoderSession:
    """Encodes one sequence.

    Parameters
    ----------
    config : CodecConfig
        Configuration; the key frames' parameter sets are filled in here.
    """

    def __init__(self, config: CodecConfig) -> None:
        video, key = config.video, config.key
        self._key_encoder = KeyFrameEncoder(
            video.width, video.height, "lossless" if key.lossless else key.qp, video.luma_only
        )
        self.config = replace(config, key=replace(key, parameter_sets=self._key_encoder.parameter_sets))
        self._wyner_ziv_encoder = WynerZivEncoder(self.config)
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
        for group in self._groups(frames):
            encoded = self._encode(group)
            started = time.process_time()
            payloads = tuple(frame.buffered_payload() for frame in encoded.frames)
            self.statistics.wyner_ziv_cpu_s += time.process_time() - started
            writer.write_gop(GopRecord(len(payloads) + 1, encoded.key, b"", payloads))
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
        raise NotImplementedError

    def _groups(self, frames: Iterable[Frame]) -> Iterator[Group]:
        return groups(frames, self.config.gop.length)

    def _encode(self, group: Group) -> _EncodedGroup:
        started = time.process_time()
        encoded = _EncodedGroup(self._key_encoder.encode(group.key))
        between = time.process_time()
        encoded.frames = [self._wyner_ziv_encoder.encode(frame) for frame in group.wyner_ziv]
        self.statistics.key_cpu_s += between - started
        self.statistics.wyner_ziv_cpu_s += time.process_time() - between
        self.statistics.num_key_frames += 1
        self.statistics.num_wyner_ziv_frames += len(encoded.frames)
        self.statistics.key_bits += 8 * len(encoded.key)
        return encoded
