"""The test clips from their public sources: download, crop, scale, comparison with the recorded digest."""

import hashlib
import shutil
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from http.client import HTTPException
from pathlib import Path

import numpy as np

from dvc.errors import ConfigError, VideoError
from dvc.video import Frame, create_video, open_video
from dvc.video.frames import Plane
from sequences.clip_sources import DIGESTS, NOT_REPEATABLE, SIZE, SOURCES, Source

MAX_FILE_BYTES = 2**28
TIMEOUT_S = 30.0
"""Longest wait for an answer, or for the next part of it."""
MAX_FILE_S = 900.0
_CHUNK_BYTES = 2**16

Bar = Callable[[str, int | None], AbstractContextManager[Callable[[int], None]]]


def chosen(names: list[str]) -> list[str]:
    """Return the named clips without duplicates, or all of them if none is named."""
    for name in names:
        if name in NOT_REPEATABLE:
            raise ConfigError(f"{name} cannot be made: {NOT_REPEATABLE[name]}")
        if name not in SOURCES:
            raise ConfigError(f"no clip is called {name!r}; the clips are {', '.join(SOURCES)}")
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
    """Make a clip; with a wrong digest it stays as ``NAME-unchecked.mkv``, and an error is raised."""
    import cv2

    source, final = SOURCES[name], out / f"{name}.mkv"
    if final.exists():
        _compare(name, final)
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
                height, width = planes[0].shape
                scaled = []  # each plane cropped, and scaled by area averaging
                for plane, side in zip(planes, (1, 2, 2), strict=True):
                    across, down = width // plane.shape[1], height // plane.shape[0]
                    x, y, columns, rows = np.floor_divide(source.crop, (across, down, across, down)).tolist()
                    cut, target = plane[y : y + rows, x : x + columns], (SIZE[0] // side, SIZE[1] // side)
                    smooth = cv2.resize(cut, target, interpolation=cv2.INTER_AREA)
                    scaled.append(smooth.astype(np.uint8, copy=False))
                luma, cb, cr = scaled
                writer.write(Frame(luma, (cb, cr)))
                count += 1
                progress(1)
            if count != source.num_frames:
                raise VideoError(f"{name}: the source ends after {count} of {source.num_frames} frames")
    _compare(name, unchecked)
    unchecked.rename(final)
    return final


def _compare(name: str, path: Path) -> None:
    """Refuse a clip if its digest is not the recorded one."""
    actual = digest(path)
    if actual != DIGESTS[name]:
        raise VideoError(
            f"{name}: {path} is not the clip that results were measured on "
            f"(digest {actual[:16]}, expected {DIGESTS[name][:16]})"
        )


def _get(origin: str, source: Source, path: str, target: Path) -> None:
    """Copy one source file from a folder or an address."""
    if "://" in origin:
        address = f"{origin.rstrip('/')}/{source.repository}/{source.commit}"
        _download(f"{address}/{urllib.parse.quote(path)}", target)
        return
    folder = Path(origin)
    paths = [folder / source.repository / source.commit / path, folder / path, folder / Path(path).name]
    existing = next((candidate for candidate in paths if candidate.is_file()), None)
    if existing is None:
        raise VideoError(f"{folder}: neither {path} nor {Path(path).name} exists")
    shutil.copyfile(existing, target)


def _download(url: str, target: Path) -> None:
    """Download a file of bounded size in bounded time."""
    if urllib.parse.urlsplit(url).scheme not in ("http", "https"):
        raise ConfigError(f"{url}: only http and https addresses and folders are accepted")
    size, end = 0, time.monotonic() + MAX_FILE_S
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT_S) as answer, target.open("wb") as file:
            length = answer.headers.get("Content-Length")
            expected = None if length is None else int(length)
            while chunk := answer.read1(_CHUNK_BYTES):
                size += len(chunk)
                if size > MAX_FILE_BYTES:
                    raise VideoError(f"{url}: larger than {MAX_FILE_BYTES >> 20} MiB")
                if time.monotonic() > end:
                    raise VideoError(f"{url}: not complete after {MAX_FILE_S:.0f} s")
                file.write(chunk)
    except urllib.error.HTTPError as err:
        raise VideoError(f"{url}: {err.code} {err.reason}") from err
    except (OSError, HTTPException, ValueError) as err:
        raise VideoError(f"{url}: {getattr(err, 'reason', None) or err}") from err
    if expected is not None and size != expected:
        raise VideoError(f"{url}: the connection ended after {size} of {expected} bytes")


def _planes(source: Source, files: list[Path]) -> Iterator[list[Plane]]:
    """Yield luma and chroma of the source frames: 4:2:0 of a video, BT.601 limited-range 4:4:4 of images."""
    import av

    if len(files) == 1:
        first, count = source.first, source.num_frames
        with open_video(files[0], size=source.size, start=first, num_frames=count) as reader:
            for frame in reader:
                coloured = frame.with_chroma()
                yield [coloured.luma, *(coloured.chroma or ())]
        return
    for file in files:
        try:
            with av.open(str(file)) as container:
                picture = next(container.decode(video=0))
        except (av.error.FFmpegError, IndexError, StopIteration) as err:
            raise VideoError(f"{file.name}: not a readable image") from err
        if (picture.width, picture.height) != source.size:
            shape = "{}x{} pixels, expected {}x{}".format(picture.width, picture.height, *source.size)
            raise VideoError(f"{file.name}: {shape}")
        converted = picture.reformat(format="yuv444p", dst_colorspace="ITU601", dst_color_range="MPEG")
        yield list(converted.to_ndarray())
