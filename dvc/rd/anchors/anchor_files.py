"""Files of anchors: write an elementary stream, decode it with FFmpeg, compare it with the original."""

import os
import re
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc.errors import BitstreamError, ConfigError, VideoError
from dvc.files import atomic_output
from dvc.metrics import PSNR_CAP_DB, mean_psnr_db, psnr_db, psnr_yuv_db
from dvc.rd.anchors import FILE_FORMATS, AnchorCodec
from dvc.video import Frame, create_video, open_video
from dvc.video.frames import check_size
from dvc.video.pixels import frame_from_picture, picture_from_frame

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer
    from av.video.codeccontext import VideoCodecContext

READ_AT_ONCE = 64
"""Number of frames that are read before they are coded, so that reading ahead does not count as coding."""
_LIBRARY_FILES = {"libx264": "libx264-", "libx265": "libx265-", "libsvtav1": "libSvtAv1Enc-"}
_PSNRS = ("psnr_y_db", "psnr_cb_db", "psnr_cr_db")
_STRICT = {"err_detect": "crccheck+bitstream+buffer+explode", "ec": "0"}
_UNIT_START = re.compile(rb"(?=\x00\x00\x00\x01)|(?<!\x00)(?=\x00\x00\x01)")
_MESSAGES = {"h264": {6}, "hevc": {39, 40}}
"""Types of NAL units that hold messages (SEI)."""
_MAX_LEB128_BYTES = 8
# OBU_FRAME_HEADER, OBU_TILE_GROUP, OBU_FRAME, OBU_REDUNDANT_FRAME_HEADER, OBU_TILE_LIST ([AV1] 6.2.2).
_AV1_PICTURE_TYPES = frozenset({3, 4, 6, 7, 8})


def encode_file(
    source: str | Path,
    path: str | Path,
    codec: AnchorCodec,
    qp: int,
    start: int = 0,
    frames: int | None = None,
    *,
    luma_only: bool = False,
) -> dict[str, Any]:
    """Code a video, or its luma, into a file; return counts, processor time and configuration."""
    if Path(path).suffix != codec.suffix:
        raise ConfigError(f"a file of {codec.name} ends in {codec.suffix}, got {str(path)!r}")
    import av

    pixel_format = codec.pixel_format(luma_only=luma_only)
    num_frames, is_finished = 0, False
    with open_video(source, start=start, num_frames=frames) as reader, atomic_output(path) as temporary:
        started = time.process_time()
        context = _open(codec, qp, reader.info.size, reader.info.frame_rate, pixel_format)
        # The first packet of AV1 holds the sequence header.
        header = b"" if codec.file_format == "obu" else context.extradata or b""
        cpu_s = time.process_time() - started
        frames_left = iter(reader)
        with temporary.open("wb") as file:
            file.write(without_overhead(header, codec.file_format))
            while not is_finished:
                batch = [
                    one.without_chroma() if luma_only else one for one in islice(frames_left, READ_AT_ONCE)
                ]
                is_finished = not batch
                started = time.process_time()
                packets = []
                for frame in batch:
                    picture = picture_from_frame(frame, pixel_format)
                    picture.pts = num_frames
                    num_frames += 1
                    packets += context.encode(picture)
                if is_finished:  # the encoder still holds frames
                    packets += context.encode(None)
                parts = [without_overhead(bytes(packet), codec.file_format, header) for packet in packets]
                cpu_s += time.process_time() - started
                file.write(b"".join(parts))
        num_bytes = temporary.stat().st_size
    return {
        "frames": num_frames,
        "bytes": num_bytes,
        "coding_cpu_s": cpu_s,
        "config": {
            "encoder": codec.library,
            "preset": codec.preset,
            "pixel_format": pixel_format,
            "qp": qp,
            "encoder_qp": codec.encoder_qp(qp),
            "parameters": codec.encoder_parameters(qp),
            "libraries": {
                "av": av.__version__,
                codec.library: _library_version(codec.library),
                "libavcodec": ".".join(str(part) for part in av.library_versions["libavcodec"]),
            },
        },
    }


def _open(
    codec: AnchorCodec, qp: int, size: tuple[int, int], rate: Fraction, pixel_format: str
) -> "VideoCodecContext":
    import av
    from av.codec.context import Flags

    if codec.library not in av.codecs_available:
        raise ConfigError(f"{codec.name}: this PyAV was built without the encoder {codec.library}")
    os.environ.setdefault("SVT_LOG", "1")  # makes SVT-AV1 report errors only
    context = av.CodecContext.create(codec.library, "w")
    context.width, context.height = size
    context.pix_fmt = pixel_format
    context.framerate, context.time_base = rate, 1 / rate
    context.thread_count = 1
    context.flags |= Flags.global_header
    words = ":".join(f"{name}={value}" for name, value in codec.encoder_parameters(qp).items())
    if codec.library == "libx264":
        context.profile = "High"
    if codec.library == "libx265":
        words = f"log-level=-1:{words}"
    context.options = {"preset": codec.preset, f"{codec.library.removeprefix('lib')}-params": words}
    try:
        context.open()
    except (av.FFmpegError, ValueError) as err:
        raise ConfigError(f"{codec.library} does not code {size[0]}x{size[1]} pictures in this way") from err
    return context


def _library_version(library: str) -> str | None:
    """Read the version of an encoder from the name of its file; None outside binary wheels."""
    import av

    for path in sorted((Path(av.__file__).parent.parent / "av.libs").glob(_LIBRARY_FILES[library] + "*")):
        if match := re.search(r"\.so\.([0-9.]+)$", path.name):
            return match[1]
    return None


def nal_units(stream: bytes) -> list[bytes]:
    """Split a byte stream ([H264] annex B) into NAL units that keep their start codes."""
    return [unit for unit in _UNIT_START.split(stream) if _UNIT_START.match(unit)]


def _unit_type(unit: bytes, file_format: str) -> int:
    """Return `nal_unit_type` of H.264 (0 to 31) or H.265 (0 to 63)."""
    header = unit.lstrip(b"\x00")[1:2] or b"\x00"
    return header[0] & 31 if file_format == "h264" else header[0] >> 1 & 63


def without_overhead(stream: bytes, file_format: str, header: bytes = b"") -> bytes:
    """Drop messages (x264 writes its options there) and repeated parameter sets."""
    if file_format == "obu":
        return stream
    repeated = {unit.lstrip(b"\x00") for unit in nal_units(header)}
    return b"".join(
        unit
        for unit in nal_units(stream)
        if _unit_type(unit, file_format) not in _MESSAGES[file_format]
        and unit.lstrip(b"\x00") not in repeated
    )


def picture_bytes(packet: bytes, file_format: str) -> int:
    """Count the bytes of a packet that belong to slices or tiles."""
    if file_format == "obu":
        return sum(size for kind, size in _av1_units(packet) if kind in _AV1_PICTURE_TYPES)
    types = range(1, 6) if file_format == "h264" else range(32)
    return sum(len(unit) for unit in nal_units(packet) if _unit_type(unit, file_format) in types)


def _av1_units(packet: bytes) -> Iterator[tuple[int, int]]:
    """Yield type and size of the open bitstream units of the low-overhead format ([AV1] 5.3)."""
    position = 0
    while position < len(packet):
        start, header = position, packet[position]
        position += 2 if header & 4 else 1
        size = len(packet) - position
        if header & 2:  # a size in LEB128
            size = 0
            for index, byte in enumerate(packet[position : position + _MAX_LEB128_BYTES]):
                size |= (byte & 127) << 7 * index
                if byte < 128:
                    position += index + 1
                    break
            else:
                raise BitstreamError("AV1: a unit without a valid length")
        position += size
        if position > len(packet):
            raise BitstreamError("AV1: a unit is longer than its packet")
        yield header >> 3 & 15, position - start


@dataclass(frozen=True)
class DecodedPicture:
    """One picture of a file."""

    frame: Frame
    is_intra: bool  # coded without prediction from other pictures
    num_bits: int  # size of its slices or tiles


def decode_file(path: Path) -> Iterator[DecodedPicture]:
    """Decode an elementary stream."""
    import av
    from av.video.frame import PictureType

    file_format = FILE_FORMATS.get(path.suffix)
    if file_format is None:
        raise ConfigError(f"{path.name}: expected {' or '.join(FILE_FORMATS)}")
    sizes: list[int] = []
    num_pictures = 0
    try:
        with av.open(f"file:{path.absolute()}", format=file_format) as container:
            for picture in _pictures(container, sizes, file_format):
                if picture.is_corrupt:
                    raise VideoError(f"{path.name}: damaged after {num_pictures} pictures")
                if picture.pts is None:
                    raise ValueError("a picture without a packet")
                num_pictures += 1
                is_intra = picture.pict_type == PictureType.I
                yield DecodedPicture(frame_from_picture(picture), is_intra, sizes[picture.pts])
    except (av.FFmpegError, ValueError, IndexError) as err:
        raise VideoError(
            f"{path.name}: damaged after {num_pictures} pictures ({getattr(err, 'strerror', None) or err})"
        ) from err
    if num_pictures != len(sizes):
        raise VideoError(f"{path.name}: {num_pictures} pictures from {len(sizes)} packets")


def _pictures(container: "InputContainer", sizes: list[int], file_format: str) -> "Iterator[VideoFrame]":
    """Decode; the time stamp of a picture becomes the index of its packet's bits in `sizes`."""
    if not container.streams.video:
        raise ValueError("no pictures")
    stream = container.streams.video[0]
    context = stream.codec_context
    check_size(max(context.width, 1), max(context.height, 1), "the file")
    context.options = _STRICT
    context.thread_count = 1
    for packet in container.demux(stream):
        if packet.size:
            packet.pts = packet.dts = len(sizes)
            sizes.append(8 * picture_bytes(bytes(packet), file_format))
        yield from stream.decode(packet)


def measure_file(
    path: Path,
    reference: str | Path,
    start: int = 0,
    *,
    luma_only: bool = False,
    video: Path | None = None,
) -> dict[str, Any]:
    """Decode a file and compare it with its original; the rate is the size of the file."""
    rows: list[dict[str, Any]] = []
    with open_video(reference, start=start) as original:
        info = original.info
        output = None if video is None else create_video(video, info.size, info.frame_rate, luma_only=True)
        with output or nullcontext():
            for index, (picture, frame) in enumerate(zip_longest(decode_file(path), original)):
                if picture is None:
                    break
                if frame is None:
                    raise VideoError(f"{path.name}: has more than the {index} pictures of the original")
                if picture.frame.luma.shape != frame.luma.shape:
                    shapes = f"{picture.frame.luma.shape}, not {frame.luma.shape}"
                    raise VideoError(f"{path.name}: pictures of {shapes}")
                originals = (frame.luma, *(() if luma_only else frame.chroma or ()))
                coded = (picture.frame.luma, *(picture.frame.chroma or ()))
                psnrs = (min(psnr_db(*pair), PSNR_CAP_DB) for pair in zip(originals, coded, strict=False))
                kind = "intra" if picture.is_intra else "inter"
                row: dict[str, Any] = {"index": index, "type": kind, "bits": picture.num_bits}
                rows.append(row | dict(zip(_PSNRS, psnrs, strict=False)))
                if output is not None:
                    output.write(picture.frame.without_chroma())
            if not rows:
                raise VideoError(f"{path.name}: no pictures")
    num_bytes, duration_s = path.stat().st_size, float(len(rows) / info.frame_rate)
    bits = {kind: sum(row["bits"] for row in rows if row["type"] == kind) for kind in ("intra", "inter")}
    bits["header"] = 8 * num_bytes - sum(bits.values())
    means_db = {name: mean_psnr_db([row[name] for row in rows]) for name in _PSNRS if name in rows[0]}
    in_colour = {"psnr_yuv_db": psnr_yuv_db(*means_db.values())} if len(means_db) == len(_PSNRS) else {}
    by_type = {
        f"{kind}_psnr_y_db": mean_psnr_db(psnrs_db)
        for kind in ("intra", "inter")
        if (psnrs_db := [row["psnr_y_db"] for row in rows if row["type"] == kind])
    }
    totals = {
        "frames": len(rows),
        "duration_s": duration_s,
        "stream_bytes": num_bytes,
        "rate_kbps": 8 * num_bytes / duration_s / 1000,
        "bits": bits,
        **means_db,
        **in_colour,
        **by_type,
    }
    return {
        "width": info.width,
        "height": info.height,
        "frames_per_s": float(info.frame_rate),
        "totals": totals,
        "per_frame": rows,
    }
