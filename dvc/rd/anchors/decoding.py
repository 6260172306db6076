"""Measure an anchor's file: decode it with FFmpeg, compare it with the original, count its bits."""

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dvc.errors import ConfigError, VideoError
from dvc.metrics import PSNR_CAP_DB, mean_psnr_db, psnr_db, psnr_yuv_db
from dvc.rd.anchors.bitstream import picture_bytes
from dvc.video import Frame, create_video, open_video
from dvc.video.frames import Plane, check_size
from dvc.video.pixels import frame_from_picture

if TYPE_CHECKING:
    import av
    from av.container import InputContainer

_PSNRS = ("psnr_y_db", "psnr_cb_db", "psnr_cr_db")
_FORMATS = {".264": "h264", ".265": "hevc", ".obu": "obu"}
_STRICT = {"err_detect": "crccheck+bitstream+buffer+explode", "ec": "0"}


@dataclass(frozen=True)
class DecodedPicture:
    """One picture of a file."""

    frame: Frame
    is_intra: bool  # whether it was coded without prediction from other pictures
    num_bits: int  # of its slices or tiles
    num_vectors: int  # motion vectors, and those of them that are not zero; 0 where they were not asked for
    num_moving: int


def decode_file(path: Path, *, vectors: bool = False) -> Iterator[DecodedPicture]:
    """Decode an elementary stream."""
    import av

    file_format = _FORMATS.get(path.suffix)
    if file_format is None or (vectors and file_format != "h264"):
        raise ConfigError(f"{path.name}: expected {' or '.join(['.264'] if vectors else _FORMATS)}")
    sizes: list[int] = []
    num_pictures = 0
    try:
        with av.open(f"file:{path.absolute()}", format=file_format) as container:
            for picture in _pictures(container, sizes, file_format, vectors):
                if picture.is_corrupt:
                    raise VideoError(f"{path.name}: damaged after {num_pictures} pictures")
                num_pictures += 1
                yield _decoded(picture, sizes, vectors)
    except (av.FFmpegError, ValueError, IndexError) as err:
        raise VideoError(
            f"{path.name}: damaged after {num_pictures} pictures ({getattr(err, 'strerror', None) or err})"
        ) from err
    if num_pictures != len(sizes):
        raise VideoError(f"{path.name}: {num_pictures} pictures from {len(sizes)} packets")


def measure_file(
    path: Path,
    reference: str | Path,
    start: int = 0,
    *,
    zero_motion: bool = False,
    luma_only: bool = False,
    video: Path | None = None,
) -> dict[str, Any]:
    """Decode a file and compare it with its original."""
    rows, moved, num_vectors = [], 0, 0
    with open_video(reference, start=start) as original:
        info = original.info
        output = None if video is None else create_video(video, info.size, info.frame_rate, luma_only=True)
        with output or nullcontext():
            for index, picture, frame in _pairs(path, original, zero_motion):
                found, expected = picture.frame.luma.shape, frame.luma.shape
                if found != expected:
                    raise VideoError(f"{path.name}: pictures of {found}, not {expected}")
                num_vectors, moved = num_vectors + picture.num_vectors, moved + picture.num_moving
                rows.append(_row(index, picture, frame.without_chroma() if luma_only else frame))
                if output is not None:
                    output.write(picture.frame.without_chroma())
            if not rows:
                raise VideoError(f"{path.name}: no pictures")
            if moved:
                raise VideoError(f"{path.name}: {moved} of {num_vectors} motion vectors are not zero")
            if zero_motion and not num_vectors and not _exports_vectors():
                raise VideoError(f"{path.name}: FFmpeg tells no motion vectors, so that none can be checked")
    measured = {
        "width": info.width,
        "height": info.height,
        "frames_per_s": float(info.frame_rate),
        "totals": _totals(rows, path.stat().st_size, float(len(rows) / info.frame_rate)),
        "per_frame": rows,
    }
    return measured | ({"num_vectors": num_vectors, "num_nonzero_vectors": moved} if zero_motion else {})


def _pairs(
    path: Path, original: "Iterator[Frame] | Any", vectors: bool
) -> Iterator[tuple[int, DecodedPicture, Frame]]:
    """Yield each picture with its original; the original may be longer."""
    for index, (picture, frame) in enumerate(zip_longest(decode_file(path, vectors=vectors), original)):
        if picture is None:
            return
        if frame is None:
            raise VideoError(f"{path.name}: has more than the {index} pictures of the original")
        yield index, picture, frame


def _pictures(
    container: "InputContainer", sizes: list[int], file_format: str, vectors: bool
) -> Iterator["av.VideoFrame"]:
    """Decode; the time stamp of a picture becomes the number of its packet, whose bits go to `sizes`."""
    if not container.streams.video:
        raise ValueError("no pictures")
    stream = container.streams.video[0]
    context = stream.codec_context
    check_size(max(context.width, 1), max(context.height, 1), "the file")
    context.options = _STRICT | ({"flags2": "+export_mvs"} if vectors else {})
    context.thread_count = 1
    for packet in container.demux(stream):
        if packet.size:
            packet.pts = packet.dts = len(sizes)
            sizes.append(8 * picture_bytes(bytes(packet), file_format))
        yield from stream.decode(packet)


def _decoded(picture: "av.VideoFrame", sizes: list[int], vectors: bool) -> DecodedPicture:
    from av.video.frame import PictureType

    num_vectors = num_moving = 0
    is_intra = picture.pict_type == PictureType.I
    if vectors and not is_intra:
        num_vectors, num_moving = _count_vectors(picture)
    if picture.pts is None:
        raise ValueError("a picture without a packet")
    frame = frame_from_picture(picture)
    return DecodedPicture(frame, is_intra, sizes[picture.pts], num_vectors, num_moving)


def _count_vectors(picture: "av.VideoFrame") -> tuple[int, int]:
    from av.sidedata.sidedata import Type

    side_data: Any = picture.side_data
    found = side_data.get(Type.MOTION_VECTORS)
    if found is None:
        return 0, 0
    vectors = found.to_ndarray()
    moving = (vectors["motion_x"] != 0) | (vectors["motion_y"] != 0)
    return len(vectors), int(np.count_nonzero(moving))


@cache
def _exports_vectors() -> bool:
    """Tell whether FFmpeg shows the vectors of pictures that surely have some: a still one, coded twice."""
    import av

    encoder = av.CodecContext.create("libx264", "w")
    encoder.width = encoder.height = 64
    encoder.pix_fmt, encoder.time_base = "yuv420p", Fraction(1, 25)
    encoder.options = {"bf": "0", "x264-params": "rc-lookahead=0:sync-lookahead=0"}
    decoder = av.CodecContext.create("h264", "r")
    decoder.options = {"flags2": "+export_mvs"}
    packets = []
    for index in range(2):
        picture = av.VideoFrame.from_ndarray(np.tile(np.arange(64, dtype=np.uint8), (96, 1)), "yuv420p")
        picture.pts = index
        packets += encoder.encode(picture)
    decoded = [
        picture for packet in (*packets, *encoder.encode(), None) for picture in decoder.decode(packet)
    ]
    return sum(_count_vectors(picture)[0] for picture in decoded) > 0


def _row(index: int, picture: DecodedPicture, original: Frame) -> dict[str, Any]:
    planes = zip(_planes(original), _planes(picture.frame), strict=False)
    return {
        "index": index,
        "type": "intra" if picture.is_intra else "inter",
        "bits": picture.num_bits,
        **{name: min(psnr_db(*pair), PSNR_CAP_DB) for name, pair in zip(_PSNRS, planes, strict=False)},
    }


def _planes(frame: Frame) -> tuple[Plane, ...]:
    return frame.luma, *(frame.chroma or ())


def _totals(rows: list[dict[str, Any]], num_bytes: int, duration_s: float) -> dict[str, Any]:
    """Sum up; the size of the file is the rate, whatever its units are."""
    bits = {kind: sum(row["bits"] for row in rows if row["type"] == kind) for kind in ("intra", "inter")}
    bits["header"] = 8 * num_bytes - sum(bits.values())
    psnrs = {
        kind: [row["psnr_y_db"] for row in rows if kind in ("", row["type"])]
        for kind in ("", "intra", "inter")
    }
    means_db = {name: mean_psnr_db([row[name] for row in rows]) for name in _PSNRS if name in rows[0]}
    return {
        "frames": len(rows),
        "duration_s": duration_s,
        "stream_bytes": num_bytes,
        "rate_kbps": 8 * num_bytes / duration_s / 1000,
        "bits": bits,
        **means_db,
        **({"psnr_yuv_db": psnr_yuv_db(*means_db.values())} if len(means_db) == len(_PSNRS) else {}),
        **{f"{kind}_psnr_y_db": mean_psnr_db(psnrs[kind]) for kind in ("intra", "inter") if psnrs[kind]},
    }
