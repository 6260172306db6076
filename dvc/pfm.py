"""Portable float maps: one plane of 32-bit floats behind a text header, rows from the bottom up."""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvc.errors import VideoError
from dvc.files import read_whole

MAX_HEADER_BYTES = 256


def write_pfm(path: str | Path, plane: NDArray[np.float32]) -> None:
    """Write a plane as little-endian PFM; inverse of `read_pfm`."""
    height, width = plane.shape
    header = f"Pf\n{width} {height}\n-1.0\n".encode()
    Path(path).write_bytes(header + plane[::-1].astype("<f4").tobytes())


def read_pfm(path: str | Path) -> NDArray[np.float32]:
    """Read a grey PFM file of either byte order."""
    content = read_whole(path)
    head = content[:MAX_HEADER_BYTES].split(b"\n", 3)
    try:
        width, height = (int(word) for word in head[1].split())
        scale = float(head[2])
    except (IndexError, ValueError) as err:
        raise VideoError(f"{path}: not a PFM file") from err
    start = sum(len(line) + 1 for line in head[:3])
    if head[0] != b"Pf" or min(width, height) < 1 or not math.isfinite(scale):
        raise VideoError(f"{path}: not a grey PFM file")
    if len(content) - start != 4 * width * height:
        raise VideoError(f"{path}: {width}x{height} values announced, {(len(content) - start) / 4:g} found")
    plane = np.frombuffer(content, dtype="<f4" if scale < 0 else ">f4", offset=start)
    plane = plane.reshape(height, width)[::-1].astype(np.float32)
    plane[np.isnan(plane)] = np.nan  # others, which signal, warn wherever they are used
    return plane
