"""Clouds of coloured points as binary PLY files."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

VERTEX = np.dtype([("position", "<f4", 3), ("colour", "u1", 3)])
_HEADER = """\
ply
format binary_little_endian 1.0
comment {comment}
element vertex {count}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
end_header
"""


def write_ply(path: str | Path, points: Floats, colours: NDArray[np.uint8], comment: str) -> None:
    """Write points, shape (N, 3), in single precision, with red, green and blue; inverse of `read_ply`."""
    vertices = np.empty(len(points), VERTEX)
    vertices["position"], vertices["colour"] = points, colours
    with Path(path).open("wb") as file:
        file.write(_HEADER.format(comment=comment, count=len(points)).encode("ascii"))
        file.write(vertices.tobytes())


def read_ply(path: str | Path) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Read the points and colours of a file that `write_ply` has written."""
    header, _, body = Path(path).read_bytes().partition(b"end_header\n")
    if header.splitlines()[-6:] != _HEADER.encode("ascii").splitlines()[-7:-1]:
        raise ValueError(f"{path}: not a cloud of coloured points")
    vertices = np.frombuffer(body, VERTEX)
    return vertices["position"], vertices["colour"]
