"""Groups of pictures before and after decoding, as plain data that goes from process to process."""

import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.protocol import ReferenceFrame
from dvc.errors import BitstreamError
from dvc.stream import Form, GopRecord
from dvc.turbo import Place
from dvc.video import Frame


@dataclass(frozen=True)
class GroupTask:
    """A group of pictures whose Wyner-Ziv frames may be decoded anywhere.

    Attributes
    ----------
    config : bytes
        Configuration of the stream, as `dvc.config.encode_config` packs it.
    number : int
        Number of the group, from 0.
    first_index : int
        Display position of its first frame.
    before : ReferenceFrame or None
        The decoded frame before it; None for the first group of a sequence.
    key : Frame or None
        The key frame that ends it; None where its last frame is a Wyner-Ziv frame.
    record : GopRecord
        What the stream, or the encoder, sent of it.
    form : Form, optional
        Form of the stream; none where a live encoder answers.
    """

    config: bytes
    number: int
    first_index: int
    before: ReferenceFrame | None
    key: Frame | None
    record: GopRecord
    form: Form | None

    @property
    def last_index(self) -> int:
        """Display position of its last frame."""
        return self.first_index + self.record.num_frames - 1


class Answered(NamedTuple):
    """Bits that were asked for while a group is decoded.

    Attributes
    ----------
    number : int
        Number of the group.
    place : tuple of two int
        Numbers of the frame and of the plane.
    bits : ndarray of shape (count,), uint8
        The bits.
    """

    number: int
    place: Place
    bits: NDArray[np.uint8]


@dataclass(frozen=True)
class BandCost:
    """What the decoded planes of a band of one frame cost.

    Attributes
    ----------
    band : int
        Number of the band in zigzag order.
    ideal_bits : float
        Ideal code length of their bits under the decoder's own prior probabilities.
    bits : int
        All bits received for them; not those of a check of the whole frame.
    """

    band: int
    ideal_bits: float
    bits: int


@dataclass(frozen=True)
class DecodedFrame:
    """One decoded Wyner-Ziv frame, what it cost, and the payload that was really needed.

    Attributes
    ----------
    index : int
        Display position.
    frame : Frame
        Decoded samples.
    side_information : ndarray of shape (H, W), uint8
        The prediction before anything was decoded.
    refined_side_information : ndarray of shape (H, W), uint8
        The last prediction.
    method, reason : str
        Side-information method that served it; why another one could not, if so.
    num_requests : int
        Requests on the feedback channel.
    crc_bits, parity_bits : int
        Bits received.
    num_failed_planes : int
        Planes that could not be verified.
    num_left_planes : int
        Planes that were not asked for, since they would not have paid.
    band_costs : tuple of BandCost
        Cost of each band of which planes were asked for.
    punctured : bytes
        Payload of the punctured form.
    decode_s : float
        Wall-clock time, in seconds.
    """

    index: int
    frame: Frame
    side_information: NDArray[np.uint8]
    refined_side_information: NDArray[np.uint8]
    method: str
    reason: str
    num_requests: int
    crc_bits: int
    parity_bits: int
    num_failed_planes: int
    num_left_planes: int
    band_costs: tuple[BandCost, ...] = ()
    punctured: bytes = b""
    decode_s: float = 0.0

    @property
    def header_bits(self) -> int:
        """Bits of the frame's own header, padding of its payload included."""
        return 8 * len(self.punctured) - self.crc_bits - self.parity_bits


@dataclass(frozen=True)
class DecodedGroup:
    """One decoded group of pictures.

    Attributes
    ----------
    first_index : int
        Display position of its first frame.
    wyner_ziv : tuple of DecodedFrame
        Its Wyner-Ziv frames, in display order.
    key : Frame or None
        The key frame that ends it, if one does.
    record : GopRecord
        The record of the punctured form: what was really needed.
    """

    first_index: int
    wyner_ziv: tuple[DecodedFrame, ...]
    key: Frame | None
    record: GopRecord

    @property
    def frames(self) -> list[Frame]:
        """All its frames, in display order."""
        return [frame.frame for frame in self.wyner_ziv] + ([] if self.key is None else [self.key])

    @property
    def last(self) -> ReferenceFrame:
        """Its last frame."""
        return ReferenceFrame(self.first_index + self.record.num_frames - 1, self.frames[-1])

    @classmethod
    def of(cls, task: GroupTask, frames: Sequence[DecodedFrame]) -> "DecodedGroup":
        """Return a group with the record of what was needed.

        Parameters
        ----------
        task : GroupTask
            What was asked for.
        frames : sequence of DecodedFrame
            Its Wyner-Ziv frames.

        Returns
        -------
        DecodedGroup
            The group.
        """
        if task.form is Form.ONE_WAY:
            return cls(task.first_index, tuple(frames), task.key, task.record)
        payloads = tuple(frame.punctured for frame in frames)
        digest = frames_digest(frames) if frames else None
        record = replace(task.record, wyner_ziv=payloads, digest=digest)
        return cls(task.first_index, tuple(frames), task.key, record)


def following(task: GroupTask, group: DecodedGroup | None) -> GroupTask:
    """Return a task with what the group before it leaves to it.

    Parameters
    ----------
    task : GroupTask
        The task, as far as it is known without that group.
    group : DecodedGroup or None
        The group directly before it, if there is one.

    Returns
    -------
    GroupTask
        With the last frame of that group before it, where that is no key frame, which it has already.
    """
    return task if group is None or group.key is not None else replace(task, before=group.last)


def frames_digest(frames: Sequence[DecodedFrame]) -> int:
    """Return what a punctured stream keeps of the decoded frames of a group.

    Parameters
    ----------
    frames : sequence of DecodedFrame
        Wyner-Ziv frames, in display order.

    Returns
    -------
    int
        CRC-32 of their planes, luma first.
    """
    crc = 0
    for decoded in frames:
        for plane in (decoded.frame.luma, *(decoded.frame.chroma or ())):
            crc = zlib.crc32(plane.tobytes(), crc)
    return crc


@contextmanager
def naming_group(number: int, part: str = "") -> Iterator[None]:
    """Say of damage in which group of pictures it is.

    Parameters
    ----------
    number : int
        Number of the group, from 0.
    part : str, optional
        What comes before the reason.
    """
    try:
        yield
    except BitstreamError as err:
        raise BitstreamError(f"group of pictures {number}: {part}{err}") from err
