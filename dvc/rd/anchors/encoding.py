"""Write an anchor's file: one elementary stream, parameter sets once, then the pictures."""

import os
import re
import time
from collections.abc import Iterable, Iterator
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc.errors import ConfigError
from dvc.files import atomic_output
from dvc.rd.anchors.bitstream import without_overhead
from dvc.rd.anchors.codecs import AnchorCodec
from dvc.rd.anchors.zero_motion import encode_without_motion
from dvc.video import Frame, open_video
from dvc.video.pixels import picture_from_frame

if TYPE_CHECKING:
    from av.video.codeccontext import VideoCodecContext

READ_AT_ONCE = 64
"""Frames that are read before they are coded: decoders read ahead in threads of their own, whose time is not
the encoder's."""
_LIBRARY_FILES = {"libx264": "libx264-", "libx265": "libx265-", "libsvtav1": "libSvtAv1Enc-"}


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
    """Code a video into a file: its luma, or all of it."""
    if Path(path).suffix != codec.suffix:
        raise ConfigError(f"a file of {codec.name} ends in {codec.suffix}, got {str(path)!r}")
    if codec.zero_motion and not luma_only:
        raise ConfigError(f"{codec.name} codes luma only: add --luma-only")
    parameters = codec.encoder_parameters(qp)
    cpu_s, read_s, num_frames = 0.0, 0.0, 0

    def _counted(reader: Iterable[Frame]) -> Iterator[Frame]:
        nonlocal num_frames, read_s
        source = iter(reader)
        while True:
            started = time.process_time()
            read = islice(source, READ_AT_ONCE)
            frames = [frame.without_chroma() if luma_only else frame for frame in read]
            read_s += time.process_time() - started
            if not frames:
                return
            num_frames += len(frames)
            yield from frames

    with open_video(source, start=start, num_frames=frames) as reader, atomic_output(path) as temporary:
        size, rate = reader.info.size, reader.info.frame_rate
        parts = encode_frames(_counted(reader), size, rate, codec, qp, luma_only=luma_only)
        with temporary.open("wb") as file:
            while True:
                started = time.process_time()
                part = next(parts, None)
                cpu_s += time.process_time() - started
                if part is None:
                    break
                file.write(part)
        num_bytes = temporary.stat().st_size
    return {
        "frames": num_frames,
        "bytes": num_bytes,
        "coding_cpu_s": cpu_s - read_s,
        "config": _configuration(codec, qp, parameters, codec.pixel_format(luma_only=luma_only)),
    }


def encode_frames(
    frames: Iterable[Frame],
    size: tuple[int, int],
    rate: Fraction,
    codec: AnchorCodec,
    qp: int,
    *,
    luma_only: bool = False,
) -> Iterator[bytes]:
    """Code frames, and give the parts of the file as they are made."""
    parameters = codec.encoder_parameters(qp)
    if codec.zero_motion:
        _check_available(codec)
        yield from encode_without_motion(
            (frame.luma for frame in frames), size, rate, codec.preset, parameters
        )
        return
    context = _open(codec, size, rate, parameters, codec.pixel_format(luma_only=luma_only))
    # AV1 has its sequence header in the first packet anyway.
    head = b"" if codec.file_format == "obu" else context.extradata or b""
    yield without_overhead(head, codec.file_format)
    for number, frame in enumerate(frames):
        picture = picture_from_frame(frame, context.pix_fmt or "")
        picture.pts = number
        for packet in context.encode(picture):
            yield without_overhead(bytes(packet), codec.file_format, head)
    for packet in context.encode(None):
        yield without_overhead(bytes(packet), codec.file_format, head)


def _open(
    codec: AnchorCodec,
    size: tuple[int, int],
    rate: Fraction,
    parameters: dict[str, str],
    pixel_format: str,
) -> "VideoCodecContext":
    import av
    from av.codec.context import Flags

    _check_available(codec)
    os.environ.setdefault("SVT_LOG", "1")  # SVT-AV1 reads it when it is opened: errors only
    context = av.CodecContext.create(codec.library, "w")
    context.width, context.height = size
    context.pix_fmt = pixel_format
    context.framerate, context.time_base = rate, 1 / rate
    context.thread_count = 1
    context.flags |= Flags.global_header
    words = ":".join(f"{name}={value}" for name, value in parameters.items())
    name = codec.library.removeprefix("lib")
    context.options = {"preset": codec.preset, f"{name}-params": words}
    if codec.library == "libx264":
        context.profile = "High"
    if codec.library == "libx265":
        context.options = {**context.options, "x265-params": f"log-level=-1:{words}"}
    try:
        context.open()
    except (av.FFmpegError, ValueError) as err:
        raise ConfigError(f"{codec.library} does not code {size[0]}x{size[1]} pictures in this way") from err
    return context


def _check_available(codec: AnchorCodec) -> None:
    import av

    if codec.library not in av.codecs_available:
        raise ConfigError(f"{codec.name}: this PyAV was built without the encoder {codec.library}")


def _configuration(
    codec: AnchorCodec, qp: int, parameters: dict[str, str], pixel_format: str
) -> dict[str, Any]:
    """Return what an encoder was told, and which it was."""
    import av

    return {
        "encoder": codec.library,
        "preset": codec.preset,
        "pixel_format": pixel_format,
        "qp": qp,
        "encoder_qp": codec.encoder_qp(qp),
        "parameters": parameters | ({"merange": "overwritten with -1"} if codec.zero_motion else {}),
        "libraries": {
            "av": av.__version__,
            codec.library: _library_version(codec.library),
            "libavcodec": ".".join(str(part) for part in av.library_versions["libavcodec"]),
        },
    }


def _library_version(library: str) -> str | None:
    """Read the version of an encoder from the name of its file; None outside the binary wheels."""
    import av

    for path in sorted((Path(av.__file__).parent.parent / "av.libs").glob(_LIBRARY_FILES[library] + "*")):
        if found := re.search(r"\.so\.([0-9.]+)$", path.name):
            return found[1]
    return None
