"""Groups of pictures before and after decoding, as plain data that goes from process to process."""

import sys
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.protocol import ReferenceFrame
from dvc.arrays import Bytes, Floats
from dvc.config import VideoConfig
from dvc.errors import BitstreamError
from dvc.stream import Form, GopRecord, RecordingReader, StreamReader, frame_times_s
from dvc.video import Frame

Bits = Bytes
Reader = StreamReader | RecordingReader


@dataclass(frozen=True)
class GroupTask:
    """A group of pictures whose Wyner-Ziv frames may be decoded anywhere."""

    config: bytes  # configuration of the stream, as `dvc.config.encode_config` packs it
    number: int  # number of the group, from 0
    first_index: int  # display position of its first frame
    before: ReferenceFrame | None  # the key frame before it; None for the first group
    key: Frame  # the key frame that ends it
    record: GopRecord  # record of the group from the stream or the encoder
    form: Form | None  # form of the stream; None if a live encoder answers

    def key_alone(self) -> "GroupTask":
        """Return its key frame, without the frames between that and the key frame before."""
        late = None if self.record.deviations is None else self.record.deviations.of_last()
        record = replace(self.record, num_frames=1, tracks=b"", wyner_ziv=(), digest=None, deviations=late)
        return replace(self, first_index=self.last_index, before=None, record=record)

    @property
    def last_index(self) -> int:
        """Display position of its last frame."""
        return self.first_index + self.record.num_frames - 1


class Answered(NamedTuple):
    """Bits that a group has asked for together."""

    number: int  # number of the group
    bits: tuple[Bits, ...]  # bits of each request


@dataclass(frozen=True)
class BandCost:
    """Cost of the decoded planes of a band of one frame."""

    band: int  # number of the band in zigzag order
    ideal_bits: float  # ideal code length of their bits under the decoder's own prior probabilities
    bits: int  # all bits received for them; not those of a check of the whole frame


@dataclass(frozen=True)
class DecodedFrame:
    """One decoded Wyner-Ziv frame, its cost, and the payload that it needed."""

    index: int  # display position
    frame: Frame  # decoded samples
    side_information: Bytes  # the prediction before anything was decoded
    refined_side_information: Bytes  # the last prediction
    method: str  # side-information method that served it; why another one could not, if so
    reason: str
    num_requests: int = 0  # requests on the feedback channel
    crc_bits: int = 0  # bits received
    parity_bits: int = 0
    num_failed_planes: int = 0  # planes that could not be verified
    num_skipped_planes: int = 0  # planes that were not asked for, not being worth their rate
    band_costs: tuple[BandCost, ...] = ()  # cost of each band with requested planes
    header_bits: int = 0  # bits of its own header, and what fills up the payload
    # Payload of the punctured form: that of the first frame of a level has the bits of all of them.
    punctured: bytes = b""
    decode_s: float = 0.0  # wall-clock time, in seconds
    # Inverse depth that predicted it, if dense, in the unit of a model of its group.
    inverse_depth: NDArray[np.float16] | None = None
    camera: Floats | None = None  # camera of the frame, in the basis of its group's model


@dataclass(frozen=True)
class DecodedGroup:
    """One decoded group of pictures."""

    first_index: int  # display position of its first frame
    wyner_ziv: tuple[DecodedFrame, ...]  # its Wyner-Ziv frames, in display order
    key: Frame  # the key frame that ends it
    record: GopRecord  # record of the punctured form: the data that were needed
    # Of a live run: time from its arrival until it was handed on, in seconds, and messages with requests that
    # were sent since the group before was.
    delay_s: float | None = None
    num_messages: int = 0

    @property
    def frames(self) -> list[Frame]:
        """All its frames, in display order."""
        return [*(frame.frame for frame in self.wyner_ziv), self.key]

    def times_s(self, video: VideoConfig) -> list[Fraction]:
        """Return when its frames are shown, in seconds."""
        return frame_times_s(video, self.first_index, self.record.num_frames, self.record.deviations)

    @classmethod
    def of(cls, task: GroupTask, frames: Sequence[DecodedFrame]) -> "DecodedGroup":
        """Return a group with the record of the needed data."""
        if task.form is Form.NO_FEEDBACK:
            return cls(task.first_index, tuple(frames), task.key, task.record)
        payloads = tuple(frame.punctured for frame in frames)
        digest = frames_digest(frames) if frames else None
        record = replace(task.record, wyner_ziv=payloads, digest=digest)
        return cls(task.first_index, tuple(frames), task.key, record)


def frames_digest(frames: Sequence[DecodedFrame]) -> int:
    """Return the digest of the decoded frames of a group for a punctured stream."""
    crc = 0
    for decoded in frames:
        for plane in (decoded.frame.luma, *(decoded.frame.chroma or ())):
            crc = zlib.crc32(plane.tobytes(), crc)
    return crc


@contextmanager
def naming_group(number: int, part: str = "") -> Iterator[None]:
    """Prefix damage with the number of its group of pictures."""
    try:
        yield
    except BitstreamError as err:
        raise BitstreamError(f"group of pictures {number}: {part}{err}") from err


MAX_NAMED = 20
"""Number of runs of lost frames that a message names; further ones are counted."""


class Losses:
    """Lost frames among the requested ones."""

    def __init__(self, requested: range | None = None) -> None:
        self._requested = range(sys.maxsize) if requested is None else requested
        self._runs: list[tuple[range, str]] = []
        self._end = ""

    def add(self, frames: range, reason: BitstreamError | str) -> None:
        """Record lost frames and the reason."""
        first, stop = max(frames.start, self._requested.start), min(frames.stop, self._requested.stop)
        if first < stop:
            self._runs.append((range(first, stop), str(reason)))

    def rest_of(self, task: GroupTask, damage: BitstreamError) -> DecodedGroup:
        """Record the Wyner-Ziv frames of a damaged group; return its key frame."""
        self.add(range(task.first_index, task.last_index), damage)
        return DecodedGroup.of(task.key_alone(), [])

    def pass_over(self, reader: Reader, number: int, damage: BitstreamError) -> GopRecord | None:
        """Continue reading behind a damaged group; return its remains, or None at the end."""
        with suppress(BitstreamError):
            entries = reader.index.entries
            if number < len(entries):
                reader.seek_gop(number + 1)
                num_frames = entries[number].num_frames
                return GopRecord(num_frames, b"", wyner_ziv=(b"",) * (num_frames - 1))
        self._end = str(damage)
        return None

    def error(self, num_kept: int) -> BitstreamError | None:
        """Return an error that lists the lost frames in display order, if any are lost."""
        runs: list[tuple[range, str]] = []
        for frames, why in sorted(self._runs, key=lambda run: run[0].start):
            if runs and runs[-1][0].stop == frames.start:  # keeps the first reason
                runs[-1] = range(runs[-1][0].start, frames.stop), runs[-1][1]
            else:
                runs.append((frames, why))
        named = [
            f"frames {run.start} to {run.stop - 1}: {why}" if len(run) > 1 else f"frame {run.start}: {why}"
            for run, why in runs[:MAX_NAMED]
        ]
        named += [f"{len(runs) - MAX_NAMED} more runs of frames"] * (len(runs) > MAX_NAMED)
        named += [self._end] * bool(self._end)
        return BitstreamError(f"lost: {'; '.join(named)} (frames kept: {num_kept})") if named else None
