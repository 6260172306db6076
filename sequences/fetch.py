"""Make the test clips from their public sources: download, crop, scale, and compare with the known digest."""

import hashlib
import shutil
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from http.client import HTTPException, HTTPResponse
from pathlib import Path
from typing import BinaryIO

import numpy as np

from dvc.errors import ConfigError, VideoError
from dvc.video import Frame, create_video, open_video
from dvc.video.frames import Plane
from sequences.sources import NOT_REPEATABLE, SIZE, SOURCES, Source

MAX_FILE_BYTES = 2**28
TIMEOUT_S = 30.0  # for an answer, and for each part of it
MAX_FILE_S = 900.0
_CHUNK_BYTES = 2**16

Bar = Callable[[str, int | None], AbstractContextManager[Callable[[int], None]]]


def chosen(names: list[str]) -> list[str]:
    """Return the clips that are asked for, all of them if none is named."""
    for name in names:
        if name in NOT_REPEATABLE:
            raise ConfigError(f"{name} cannot be made: {NOT_REPEATABLE[name]}")
        if name not in SOURCES:
            raise ConfigError(f"no clip is called {name!r}; there are {', '.join(SOURCES)}")
    return list(dict.fromkeys(names)) or list(SOURCES)


def digest(path: str | Path) -> str:
    """Return the SHA-256 of the size of a video and of all samples of its frames, plane by plane."""
    with open_video(path) as reader:
        total = hashlib.sha256(b"%dx%d" % reader.info.size)
        for frame in reader:
            coloured = frame.with_chroma()
            for plane in (coloured.luma, *(coloured.chroma or ())):
                total.update(plane.tobytes())
    return total.hexdigest()


def fetch(name: str, origin: str, out: Path, bar: Bar) -> Path:
    """Make one clip; one with another digest is an error and stays as ``NAME-unchecked.mkv``."""
    source, final = SOURCES[name], out / f"{name}.mkv"
    if final.exists():
        _compare(name, final, source)
        return final
    unchecked = out / f"{name}-unchecked.mkv"
    with tempfile.TemporaryDirectory(prefix="dvc-sequences-") as folder:
        with bar(f"{name}: files", len(source.paths)) as progress:
            files = []
            for index, path in enumerate(source.paths):
                files.append(Path(folder) / f"{index:04d}{Path(path).suffix}")
                _get(origin, source, path, files[-1])
                progress(1)
        with (
            bar(name, source.num_frames) as progress,
            create_video(unchecked, SIZE, source.frame_rate) as writer,
        ):
            count = 0
            for planes in _planes(source, files):
                writer.write(_scaled(planes, source.crop))
                count += 1
                progress(1)
            if count != source.num_frames:
                raise VideoError(f"{name}: the source ends after {count} of {source.num_frames} frames")
    _compare(name, unchecked, source)
    unchecked.rename(final)
    return final


def _compare(name: str, path: Path, source: Source) -> None:
    """Refuse a clip that is not the one that results are measured on."""
    found = digest(path)
    if found != source.digest:
        raise VideoError(
            f"{name}: {path} is not the clip that results were measured on "
            f"(digest {found[:16]}, expected {source.digest[:16]})"
        )


def _get(origin: str, source: Source, path: str, target: Path) -> None:
    """Copy one source file from a folder or an address."""
    if "://" in origin:
        _download(
            f"{origin.rstrip('/')}/{source.repository}/{source.commit}/{urllib.parse.quote(path)}", target
        )
        return
    folder = Path(origin)
    places = [folder / source.repository / source.commit / path, folder / path, folder / Path(path).name]
    found = next((place for place in places if place.is_file()), None)
    if found is None:
        raise VideoError(f"{folder}: neither {path} nor {Path(path).name} is there")
    shutil.copyfile(found, target)


def _download(url: str, target: Path) -> None:
    """Download a file of bounded size in bounded time."""
    if urllib.parse.urlsplit(url).scheme not in ("http", "https"):
        raise ConfigError(f"{url}: only http and https addresses and folders are read")
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT_S) as answer, target.open("wb") as file:
            length = answer.headers.get("Content-Length")
            expected = None if length is None else int(length)
            size = _receive(answer, file, url)
    except urllib.error.HTTPError as err:
        raise VideoError(f"{url}: {err.code} {err.reason}") from err
    except (OSError, HTTPException, ValueError) as err:
        raise VideoError(f"{url}: {getattr(err, 'reason', None) or err}") from err
    if expected is not None and size != expected:
        raise VideoError(f"{url}: the connection ended after {size} of {expected} bytes")


def _receive(answer: HTTPResponse, file: BinaryIO, url: str) -> int:
    """Write what comes to a file and return its size."""
    size, end = 0, time.monotonic() + MAX_FILE_S
    while chunk := answer.read1(_CHUNK_BYTES):
        size += len(chunk)
        if size > MAX_FILE_BYTES:
            raise VideoError(f"{url}: larger than {MAX_FILE_BYTES >> 20} MiB")
        if time.monotonic() > end:
            raise VideoError(f"{url}: not complete after {MAX_FILE_S:.0f} s")
        file.write(chunk)
    return size


def _planes(source: Source, files: list[Path]) -> Iterator[list[Plane]]:
    """Yield luma and chroma of the source frames: as a video has them, 4:4:4 of RGB images."""
    if len(files) == 1:
        with open_video(
            files[0], size=source.size, start=source.first, num_frames=source.num_frames
        ) as reader:
            for frame in reader:
                coloured = frame.with_chroma()
                yield [coloured.luma, *(coloured.chroma or ())]
        return
    for file in files:
        yield _image_planes(file, source.size)


def _image_planes(file: Path, size: tuple[int, int]) -> list[Plane]:
    """Read an image as BT.601 limited-range 4:4:4."""
    import av

    try:
        with av.open(str(file)) as container:
            found = (container.streams.video[0].width, container.streams.video[0].height)
            if found != size:
                raise VideoError(f"{file.name}: {found[0]}x{found[1]} pixels, expected {size[0]}x{size[1]}")
            picture = next(container.decode(video=0))
    except (av.error.FFmpegError, IndexError, StopIteration) as err:
        raise VideoError(f"{file.name}: not an image that can be read") from err
    converted = picture.reformat(format="yuv444p", dst_colorspace="ITU601", dst_color_range="MPEG")
    return list(converted.to_ndarray())


def _scaled(planes: list[Plane], crop: tuple[int, int, int, int]) -> Frame:
    """Cut a frame out of its source and scale each plane by areas."""
    import cv2

    height, width = planes[0].shape
    scaled = []
    for plane, side in zip(planes, (1, 2, 2), strict=True):
        across, down = width // plane.shape[1], height // plane.shape[0]
        x, y, columns, rows = crop[0] // across, crop[1] // down, crop[2] // across, crop[3] // down
        target = (SIZE[0] // side, SIZE[1] // side)
        cut = plane[y : y + rows, x : x + columns]
        scaled.append(cv2.resize(cut, target, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False))
    luma, cb, cr = scaled
    return Frame(luma, (cb, cr))
