"""Picture files: views in colour, levels as they are stored, planes of a folder, and portable float maps.

OpenCV refuses pictures of more than `MAX_PIXELS` before it decodes them: `dvc` sets its limit on import.
"""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc import MAX_PIXELS
from dvc.arrays import Bytes, Floats, Singles
from dvc.errors import DvcError, VideoError
from dvc.files import read_whole
from dvc.video.frames import check_size

MAP_FILE = "a picture of 8 or 16 bits, or a PFM file"
"""Accepted files of maps, for messages."""
_MAX_HEADER_BYTES = 256  # of float maps


def read_picture(path: str | Path) -> Bytes:
    """Read a picture as eight-bit red, green and blue."""
    stored = _stored(path)
    if stored is None:
        raise DvcError(f"{path}: not a picture of 8 or 16 bits that can be read")
    if stored.dtype == np.uint16:
        stored = ((stored.astype(np.uint32) + 128) // 257).astype(np.uint8)
    if stored.ndim == 2:
        stored = stored[:, :, None]
    colours = stored[:, :, :1].repeat(3, axis=2) if stored.shape[2] < 3 else stored[:, :, 2::-1]
    picture: Bytes = np.ascontiguousarray(colours)
    return picture


def read_levels(path: str | Path, expected: str = MAP_FILE) -> Floats:
    """Read the levels of a grey picture as they are stored."""
    stored = _stored(path)
    if stored is None:
        raise DvcError(f"{path}: expected {expected}")
    if stored.ndim == 3:
        colours = stored[:, :, :3] if stored.shape[2] > 2 else stored[:, :, :1]
        if (colours != colours[:, :, :1]).any():
            raise DvcError(f"{path}: expected grey levels, got colours")
        stored = colours[:, :, 0]
    return stored.astype(np.float64)


def largest_level(path: str | Path) -> int:
    """Return the largest level that the samples of a picture can have."""
    stored = _stored(path)
    if stored is None:
        raise DvcError(f"{path}: expected a picture of 8 or 16 bits")
    return int(np.iinfo(stored.dtype).max)


def read_plane(path: Path, channels: int, shape: tuple[int, int]) -> Bytes:
    """Read a PNG file of eight bits as it was written."""
    stored = _stored(path)
    expected = shape if channels == 1 else (*shape, channels)
    if stored is None or stored.dtype != np.uint8 or stored.shape != expected:
        kind = "grey" if channels == 1 else "RGBA"
        raise DvcError(f"{path}: not an eight-bit {kind} picture of {shape[1]}x{shape[0]}")
    return np.asarray(stored if channels == 1 else stored[:, :, [2, 1, 0, 3]], np.uint8)


def write_png(path: Path, picture: Bytes) -> None:
    """Write a picture."""
    try:
        done, content = cv2.imencode(".png", picture)
    except cv2.error:
        done = False
    if not done:
        raise DvcError(f"cannot write {path}")
    path.write_bytes(content.tobytes())


def _stored(path: str | Path) -> NDArray[Any] | None:
    """Decode a picture as it is stored, blue first; return None unless it has 8 or 16 bits."""
    content = read_whole(path)
    try:
        stored = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    except cv2.error as err:
        if "MAX_IMAGE" not in str(err):
            return None
        raise VideoError(f"{path}: pictures of more than {MAX_PIXELS} pixels are not supported") from err
    if stored is None or stored.dtype not in (np.uint8, np.uint16):
        return None
    check_size(stored.shape[1], stored.shape[0], str(path))
    return stored


def write_pfm(path: str | Path, plane: Singles) -> None:
    """Write a plane as a little-endian portable float map; inverse of `read_pfm`."""
    height, width = plane.shape
    header = f"Pf\n{width} {height}\n-1.0\n".encode()
    Path(path).write_bytes(header + plane[::-1].astype("<f4").tobytes())


def read_pfm(path: str | Path) -> Singles:
    """Read a grey portable float map of either byte order; rows are stored from the bottom up."""
    content = read_whole(path)
    head = content[:_MAX_HEADER_BYTES].split(b"\n", 3)
    try:
        width, height = (int(word) for word in head[1].split())
        scale = float(head[2])
    except (IndexError, ValueError) as err:
        raise VideoError(f"{path}: not a PFM file") from err
    start = sum(len(line) + 1 for line in head[:3])
    if head[0] != b"Pf" or min(width, height) < 1 or not math.isfinite(scale):
        raise VideoError(f"{path}: not a grey PFM file")
    if len(content) - start != 4 * width * height:
        raise VideoError(f"{path}: {width}x{height} values announced, {(len(content) - start) / 4:g} present")
    plane = np.frombuffer(content, dtype="<f4" if scale < 0 else ">f4", offset=start)
    plane = plane.reshape(height, width)[::-1].astype(np.float32)
    plane[np.isnan(plane)] = np.nan  # signalling ones would warn at every use
    return plane
