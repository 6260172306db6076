"""Decoding of all formats of FFmpeg; damage that FFmpeg ignores: cut files, FFV1 slices with errors."""

import os
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from dvc.errors import VideoError
from dvc.video.frames import Frame, TimeStamp, VideoInfo, check_size
from dvc.video.pixels import frame_from_picture

if TYPE_CHECKING:
    import av
    from av.container import InputContainer
    from av.video.stream import VideoStream

Extent = Callable[[], tuple[int, bytes]]
"""Function that returns the size of a source and its first bytes."""

HEAD_BYTES = 4096
LOCAL = {"protocol_whitelist": "file"}
_STRICT = {"err_detect": "crccheck+bitstream+buffer+explode"}
# FFmpeg counts every tag that its TIFF decoder does not know as an error.
_STRICT_TIFF = {"err_detect": "crccheck+bitstream+buffer"}
_EBML_ID = b"\x1a\x45\xdf\xa3"
_SEGMENT_ID = b"\x18\x53\x80\x67"
_SLICE_TRAILER_BYTES = 8  # 24 bits of size, 8 of status, 32 of checksum
_REVERSED_BITS = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def open_file(path: Path, input_format: str | None = None, **options: str) -> "InputContainer":
    """Open a local file; it may refer to local files only."""
    import av

    with av_errors(path, "is not a video that FFmpeg can read"):
        container = av.open(
            f"file:{os.path.abspath(path)}", format=input_format, options={**LOCAL, **options}
        )
    refuse_text(container, path)
    return container


def refuse_text(container: "InputContainer", path: Path | str) -> None:
    """Refuse text, which FFmpeg would draw."""
    if container.format.name == "tty":
        container.close()
        raise VideoError(f"{path}: is a text file, not a video")


def read_image(path: Path) -> "av.VideoFrame":
    """Decode one image file."""
    # By its name the file would be taken for a pattern of many names.
    container = open_file(path, pattern_type="none")
    try:
        pictures = decoded(container, video_stream(container, path), path, partial(file_extent, path))
        picture = next(pictures, None)
    finally:
        container.close()
    if picture is None:
        raise VideoError(f"{path}: holds no picture")
    return picture


def video_stream(container: "InputContainer", path: Path | str) -> "VideoStream":
    """Return the first video stream except cover pictures, with strict error detection."""
    from av.stream import Disposition

    for stream in container.streams.video:
        if not stream.disposition & Disposition.attached_pic:
            context = stream.codec_context
            if context is None:
                raise VideoError(f"{path}: is coded in a way that FFmpeg does not know")
            check_size(max(context.width, 1), max(context.height, 1), str(path))
            context.options = dict(_STRICT_TIFF if context.name == "tiff" else _STRICT)
            stream.thread_type = "AUTO"
            return stream
    raise VideoError(f"{path}: has no video stream")


def decoded(
    container: "InputContainer",
    stream: "VideoStream",
    path: Path | str,
    extent: Extent | None,
    timeout_s: float | None = None,
) -> Iterator["av.VideoFrame"]:
    """Yield the pictures of a stream; `VideoError` after the last one before any damage."""
    count = 0
    problem: str | None = None
    check = DamageCheck(extent, container, stream)
    with av_errors(path, lambda: f"damaged after {count} frames" if count else "cannot be decoded"):
        for packet in _in_time(container.demux(stream), path, timeout_s):
            problem = check.packet(packet) if packet.size else check.end()
            for picture in stream.decode(None if problem else packet):
                if picture.is_corrupt:
                    raise VideoError(f"{path}: damaged after {count} frames (the next one is incomplete)")
                check_size(picture.width, picture.height, str(path))
                count += 1
                yield picture
            if problem:
                raise VideoError(f"{path}: damaged after {count} frames ({problem})")


def _in_time(
    packets: Iterator["av.Packet[VideoStream]"], path: Path | str, timeout_s: float | None
) -> Iterator["av.Packet[VideoStream]"]:
    """Yield packets; report a timeout, which FFmpeg returns as an end or as various errors."""
    import av

    while True:
        asked_s = time.monotonic()
        failure, packet = None, None
        try:
            packet = next(packets, None)
        except av.FFmpegError as err:
            failure = err
        if timeout_s is not None and time.monotonic() - asked_s >= timeout_s:
            raise silence(path, timeout_s) from failure
        if failure is not None:
            raise failure
        if packet is None:
            return
        yield packet


def silence(path: Path | str, timeout_s: float) -> VideoError:
    """Return the error that a source sent nothing."""
    return VideoError(f"{path}: nothing came for {timeout_s:g} s")


def consistent_frames(
    pictures: Iterable[tuple[Path | str, "av.VideoFrame"]], info: VideoInfo, *, timed: bool = False
) -> Iterator[Frame]:
    """Convert pictures, with or without their times; refuse changes of size and of colour to grey."""
    is_grey: bool | None = None
    for path, picture in pictures:
        if (picture.width, picture.height) != info.size:
            raise VideoError(
                f"{path}: the picture size changes from {info.width}x{info.height} to "
                f"{picture.width}x{picture.height}"
            )
        with av_errors(path, f"the pixel format {picture.format.name} cannot be converted"):
            frame = frame_from_picture(picture)
        if is_grey not in (None, frame.chroma is None):
            raise VideoError(f"{path}: grey and colour pictures are mixed")
        is_grey = frame.chroma is None
        if timed and picture.pts is not None and picture.time_base is not None:
            time_s = picture.pts * picture.time_base
            frame = replace(frame, time=TimeStamp.nearest(time_s, picture.time_base.denominator))
        yield frame


@contextmanager
def av_errors(path: Path | str, problem: str | Callable[[], str]) -> Iterator[None]:
    """Convert errors of FFmpeg and the file system into `VideoError`."""
    import av

    try:
        yield
    except (av.FFmpegError, OSError, ValueError) as err:
        text = problem if isinstance(problem, str) else problem()
        raise VideoError(f"{path}: {text} ({getattr(err, 'strerror', None) or err})") from err


def file_extent(path: Path) -> tuple[int, bytes]:
    """Return the size of a file and its first `HEAD_BYTES`."""
    with path.open("rb") as file:
        return os.fstat(file.fileno()).st_size, file.read(HEAD_BYTES)


class DamageCheck:
    """Checks the packets of one video stream; `extent` returns size and first bytes of the source."""

    def __init__(self, extent: Extent | None, container: "InputContainer", stream: "VideoStream") -> None:
        self._extent = extent
        self._format = container.format.name
        self._declared_packets = stream.frames
        self._has_slice_checksums = stream.codec_context.name == "ffv1"
        self._num_packets = 0
        self._end_of_packets = 0

    def packet(self, packet: "av.Packet[VideoStream]") -> str | None:
        """Check one packet."""
        if packet.is_corrupt:
            return "the data fail their checks"
        if self._has_slice_checksums:
            slices = ffv1_slices(bytes(packet))
            valid = slices is not None and all(checksum_is_valid(s) for s in slices)
            if self._num_packets == 0 and not valid:
                # Checksums are optional: a first packet without a single valid one has none.
                self._has_slice_checksums = any(checksum_is_valid(s) for s in slices or ())
            if self._has_slice_checksums and not valid:
                return "the data fail their checks"
        self._num_packets += 1
        if packet.pos is not None:
            self._end_of_packets = packet.pos + packet.size
        return None

    def end(self) -> str | None:
        """Check that the file is complete."""
        if self._num_packets < self._declared_packets:
            return f"the file ends after {self._num_packets} of {self._declared_packets} frames"
        if self._extent is None:
            return None
        file_bytes, head = self._extent()
        if self._format == "yuv4mpegpipe" and 0 < self._end_of_packets < file_bytes:
            return "the file ends within a frame"
        declared_bytes = matroska_bytes(head) if "matroska" in self._format else None
        if declared_bytes is not None and file_bytes < declared_bytes:
            return f"the file ends after {file_bytes} of {declared_bytes} bytes"
        return None


def matroska_bytes(head: bytes) -> int | None:
    """Return the length of a Matroska file that its header states."""
    if not head.startswith(_EBML_ID):
        return None
    position, header_bytes = _ebml_size(head, len(_EBML_ID))
    if header_bytes is None or not head.startswith(_SEGMENT_ID, position + header_bytes):
        return None
    position, segment_bytes = _ebml_size(head, position + header_bytes + len(_SEGMENT_ID))
    return None if segment_bytes is None else position + segment_bytes


def _ebml_size(data: bytes, position: int) -> tuple[int, int | None]:
    """Return the offset of the content of an EBML element, and its size (RFC 8794, section 4)."""
    first = data[position] if position < len(data) else 0
    num_bytes = 9 - first.bit_length()
    if num_bytes > 8 or position + num_bytes > len(data):
        return position, None
    value_bits = 7 * num_bytes
    value = int.from_bytes(data[position : position + num_bytes], "big") & ((1 << value_bits) - 1)
    return position + num_bytes, None if value == (1 << value_bits) - 1 else value


def ffv1_slices(packet: bytes) -> list[bytes] | None:
    """Split a frame of FFV1 version 3 with checksums into its slices, trailers included."""
    slices = []
    end = len(packet)
    while end > 0:
        size = int.from_bytes(packet[end - 8 : end - 5], "big") + _SLICE_TRAILER_BYTES
        if size > end:
            return None
        slices.append(packet[end - size : end])
        end -= size
    return slices


def checksum_is_valid(data: bytes) -> bool:
    """Return whether data with a trailing FFV1 checksum are intact."""
    mirrored = data.translate(_REVERSED_BITS)
    return zlib.crc32(mirrored, 0xFFFFFFFF) == 0xFFFFFFFF
