"""Two views as they are: as two pictures, or the second one predicted from the first by a video codec.

Neither gives any other view than these two.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from benchmarks.baselines.picture_coders import CodedPicture, Ladder, PictureCoder
from benchmarks.baselines.quality import PeerResult, quality_of
from dvc.errors import ConfigError
from dvc.images.colour import Picture

if TYPE_CHECKING:
    from av import VideoFrame

LEVEL_OFFSETS = -6, -3, 0, 3, 6
"""Qualities of the second picture less that of the first."""
QP_OFFSETS = 0, 1, 2, 3, 4
"""QPs of the P frame less that of the I frame."""
LOWEST_QP, HIGHEST_QP = 8, 51
_MESSAGES = {"h264": (31, 0, {6}), "hevc": (63, 1, {39, 40})}
"""Mask and shift of the type of a NAL unit, and types that no decoder needs."""


@dataclass(frozen=True)
class VideoCoder:
    """A video encoder that codes an I frame and a P frame."""

    name: str  # as it is known
    library: Literal["libx264", "libx265"]  # encoder as FFmpeg names it
    decoder: Literal["h264", "hevc"]  # decoder as FFmpeg names it
    parameters: str  # all that differs from the preset, but for QPs
    preset: str = "slow"  # preset


# Constant QPs, PSNR rather than looks, wide search as views are far from each other; one thread.
X264: Final = VideoCoder(
    "x264",
    "libx264",
    "h264",
    "psy=0:scenecut=0:mbtree=0:bframes=0:weightp=0:rc-lookahead=0:sync-lookahead=0:sliced-threads=0:"
    "threads=1:me=umh:merange=64",
)
X265: Final = VideoCoder(
    "x265",
    "libx265",
    "hevc",
    "log-level=-1:psy-rd=0:psy-rdoq=0:aq-mode=0:cutree=0:scenecut=0:bframes=0:b-adapt=0:weightp=0:"
    "rc-lookahead=0:lookahead-slices=0:pools=none:frame-threads=1:wpp=0:info=0:merange=64",
)


def two_pictures(pictures: tuple[Picture, Picture], coder: PictureCoder, max_bytes: int) -> PeerResult:
    """Code both views as pictures, at the best split of the bytes."""
    ladders = [Ladder(coder, picture) for picture in pictures]
    tried = []
    for offset in LEVEL_OFFSETS:
        levels = [-1, coder.num_levels]
        while levels[1] - levels[0] > 1:
            middle = sum(levels) // 2
            levels[_size(ladders, middle, offset) > max_bytes] = middle
        if levels[0] >= 0:
            both = _pair(ladders, levels[0], offset)
            num_bytes = sum(one.num_bytes for one in both)
            quality = quality_of([one.picture for one in both], pictures)
            setting = f"{coder.name} at {both[0].level} and {both[1].level}"
            tried.append(PeerResult(num_bytes, quality, both[1].num_bytes / num_bytes, setting))
    tried = [one for one in tried if one.num_bytes <= max_bytes]
    if not tried:
        raise ConfigError(f"{max_bytes} bytes are too few for two pictures of {coder.name}")
    return max(tried, key=lambda result: result.quality.pooled_db)


def _pair(ladders: list[Ladder], level: int, offset: int) -> tuple[CodedPicture, CodedPicture]:
    highest = ladders[0].coder.num_levels - 1
    return ladders[0].at(level), ladders[1].at(min(max(level + offset, 0), highest))


def _size(ladders: list[Ladder], level: int, offset: int) -> int:
    return sum(one.num_bytes for one in _pair(ladders, level, offset))


def intra_and_predicted(pictures: tuple[Picture, Picture], coder: VideoCoder, max_bytes: int) -> PeerResult:
    """Code the first view as an I frame and the second one as a P frame, at the best pair of QPs."""
    tried = []
    for offset in QP_OFFSETS:
        low, high = LOWEST_QP - 1, HIGHEST_QP + 1 - offset
        fits: list[bytes] = []
        while high - low > 1:
            qp = (low + high) // 2
            stream = list(encode_frames(pictures, coder, qp, offset))
            if sum(map(len, stream)) <= max_bytes:
                high, fits = qp, stream
            else:
                low = qp
        if fits:
            num_bytes = sum(map(len, fits))
            quality = quality_of(decode_frames(fits, coder), pictures)
            setting = f"QP {high} and {high + offset}"
            tried.append(PeerResult(num_bytes, quality, len(fits[-1]) / num_bytes, setting))
    if not tried:
        raise ConfigError(f"{max_bytes} bytes are too few for two frames of {coder.name}")
    return max(tried, key=lambda result: result.quality.pooled_db)


def encode_frames(pictures: tuple[Picture, ...], coder: VideoCoder, qp: int, offset: int) -> Iterator[bytes]:
    """Code an I frame, and P frames after it."""
    import av

    if coder.library not in av.codecs_available:
        raise ConfigError(f"this PyAV was built without the encoder {coder.library}")
    context = av.CodecContext.create(coder.library, "w")
    context.height, context.width = pictures[0].shape
    context.pix_fmt, context.thread_count = "gray", 1
    context.framerate, context.time_base = Fraction(25), Fraction(1, 25)
    # the QP is that of P frames
    words = f"qp={qp + offset}:ipratio={2.0 ** (offset / 6.0):.4f}:keyint=250:{coder.parameters}"
    context.options = {"preset": coder.preset, f"{coder.library[3:]}-params": words}
    try:
        context.open()
        packets = []
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="gray")
            frame.pts = number
            packets += context.encode(frame)
        packets += context.encode(None)
    except (av.FFmpegError, ValueError) as err:
        raise ConfigError(f"{coder.name} does not code pictures of this size") from err
    for packet in packets:
        yield without_messages(bytes(packet), coder.decoder)


def decode_frames(stream: list[bytes], coder: VideoCoder) -> list[Picture]:
    """Decode frames."""
    import av

    context = av.CodecContext.create(coder.decoder, "r")
    context.thread_count = 1
    frames = [frame for part in stream for frame in context.decode(av.Packet(part))]
    return [_luma(frame) for frame in (*frames, *context.decode(None))]


def without_messages(stream: bytes, decoder: str) -> bytes:
    """Leave out what no decoder needs: encoders write their options there."""
    mask, shift, messages = _MESSAGES[decoder]
    units = stream.split(b"\x00\x00\x01")[1:]
    kept = [unit for unit in units if (unit[0] >> shift) & mask not in messages]
    return b"".join(b"\x00\x00\x01" + unit.rstrip(b"\x00") for unit in kept)


def _luma(frame: "VideoFrame") -> Picture:
    """Return samples as they were coded, whatever range the stream tells."""
    plane = frame.planes[0]
    rows = np.frombuffer(bytes(plane), np.uint8).reshape(-1, plane.line_size)
    return np.ascontiguousarray(rows[: plane.height, : plane.width])
