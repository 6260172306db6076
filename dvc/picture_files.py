"""Picture files: views in colour, levels as they are stored, planes of a folder."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.errors import DvcError
from dvc.files import read_whole
from dvc.picture_sizes import stated_size
from dvc.video.frames import check_size

MAP_FILE = "a picture of 8 or 16 bits, or a PFM file"
"""What maps are read from."""


def read_picture(path: str | Path) -> NDArray[np.uint8]:
    """Read a picture as eight-bit red, green and blue."""
    stored = _stored(path)
    if stored is None:
        raise DvcError(f"{path}: not a picture of 8 or 16 bits that can be read")
    if stored.dtype == np.uint16:
        stored = ((stored.astype(np.uint32) + 128) // 257).astype(np.uint8)
    if stored.ndim == 2:
        stored = stored[:, :, None]
    colours = stored[:, :, :1].repeat(3, axis=2) if stored.shape[2] < 3 else stored[:, :, 2::-1]
    picture: NDArray[np.uint8] = np.ascontiguousarray(colours)
    return picture


def read_levels(path: str | Path, expected: str = MAP_FILE) -> NDArray[np.float64]:
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
    """Return the largest level that a picture could have."""
    stored = _stored(path)
    if stored is None:
        raise DvcError(f"{path}: expected a picture of 8 or 16 bits")
    return int(np.iinfo(stored.dtype).max)


def read_plane(path: Path, channels: int, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Read a PNG file of eight bits as it was written."""
    stored = _stored(path)
    expected = shape if channels == 1 else (*shape, channels)
    if stored is None or stored.dtype != np.uint8 or stored.shape != expected:
        kind = "grey" if channels == 1 else "RGBA"
        raise DvcError(f"{path}: not an eight-bit {kind} picture of {shape[1]}x{shape[0]}")
    return np.asarray(stored if channels == 1 else stored[:, :, [2, 1, 0, 3]], np.uint8)


def write_png(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write a picture."""
    try:
        done, content = cv2.imencode(".png", picture)
    except cv2.error:
        done = False
    if not done:
        raise DvcError(f"cannot write {path}")
    path.write_bytes(content.tobytes())


def _stored(path: str | Path) -> NDArray[Any] | None:
    """Decode a picture as it is, blue first; None if it has not 8 or 16 bits, or is none.

    One that is larger than frames of videos may be is refused, by its header where that tells.
    """
    content = read_whole(path)
    if (size := stated_size(content)) is not None:
        check_size(*size, str(path))
    try:
        stored = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    except cv2.error:
        return None
    if stored is None or stored.dtype not in (np.uint8, np.uint16):
        return None
    check_size(stored.shape[1], stored.shape[0], str(path))
    return stored
