"""Videos, and recordings in segments with their index; their readers."""

from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.hostile.files import Files, mutate_text, written
from benchmarks.hostile.material import material
from benchmarks.hostile.mutations import mutate_record
from dvc.files import PARTIAL_SUFFIX
from dvc.picture_files import write_png
from dvc.stream.recording import open_stream
from dvc.video import open_video

_SHAPE = 18, 26


@cache
def good_videos() -> tuple[Files, ...]:
    """Return frames as YUV4MPEG2, raw, and as pictures."""
    height, width = _SHAPE
    planes = np.random.default_rng(8).integers(16, 236, (3, height * width * 3 // 2), np.uint8)
    head = f"YUV4MPEG2 W{width} H{height} F25:1 Ip A1:1 C420jpeg\n".encode()
    pictures = planes[:, : height * width].reshape(3, height, width)
    return (
        {"frames.y4m": head + b"".join(b"FRAME\n" + plane.tobytes() for plane in planes)},
        {"frames.yuv": planes.tobytes()},
        written(lambda folder: _write_pictures(folder, pictures)),
    )


def _write_pictures(folder: Path, pictures: NDArray[np.uint8]) -> None:
    for number, picture in enumerate(pictures):
        write_png(folder / f"{number}.png", picture)


def read_videos(folder: Path) -> bool:
    """Read all frames; those of a raw file and of pictures have the size that is said."""
    paths = sorted(folder.iterdir())
    size = {"size": (_SHAPE[1], _SHAPE[0]), "frame_rate": Fraction(25)} if paths[0].suffix == ".yuv" else {}
    with open_video(folder if len(paths) > 1 else paths[0], **size) as video:  # type: ignore[arg-type]
        shape = video.info.height, video.info.width
        return all(frame.luma.shape == shape for frame in video)


@cache
def good_recordings() -> tuple[Files, ...]:
    """Return segments of both forms, the last one unfinished."""
    made = material()
    return tuple(
        {"1.dvc": stream, "2.dvc": stream, f"3.dvc{PARTIAL_SUFFIX}": stream[: 2 * len(stream) // 3]}
        for stream in (made.buffered, made.punctured)
    )


def mutate_segment(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage a record, the index as well, and mend its checksum; or damage bytes."""
    try:
        return mutate_record(data, rng) if rng.random() < 0.7 else mutate_text(data, rng)
    except IndexError:  # the segment that is unfinished
        return mutate_text(data, rng)


def read_recordings(folder: Path) -> bool:
    """Read all groups, then the last one alone, as of a recording and of its first segment."""
    for path in (folder, folder / "1.dvc"):
        for unfinished in (True, False):
            with open_stream(str(path), unfinished=unfinished) as reader:
                num_frames = sum(record.num_frames for record in reader)
                if num_frames > 2**16 or (reader.missing is None and num_frames != reader.index.num_frames):
                    return False
                reader.seek_gop(max(len(reader.index.entries) - 1, 0))
                list(reader)
    return True
