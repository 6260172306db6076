"""Picture files: levels are kept, other kinds are taken where that is harmless, and refused elsewhere."""

import resource
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from dvc.errors import DvcError
from dvc.picture_files import largest_level, read_levels, read_picture, read_plane, write_png


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a fresh generator."""
    return np.random.default_rng(5)


@pytest.mark.parametrize("channels", [1, 4])
def test_planes_come_back(tmp_path: Path, rng: np.random.Generator, channels: int) -> None:
    plane = rng.integers(0, 256, (6, 5, channels), dtype=np.uint8).squeeze()
    write_png(tmp_path / "a.png", plane)
    found = read_plane(tmp_path / "a.png", channels, (6, 5))
    np.testing.assert_array_equal(found, plane if channels == 1 else plane[:, :, [2, 1, 0, 3]])


def test_pictures_are_red_green_blue(tmp_path: Path, rng: np.random.Generator) -> None:
    """Colours are turned, grey is tripled, 16 bits are rounded, opacity is left out."""
    colours = rng.integers(0, 256, (4, 3, 4), dtype=np.uint8)
    write_png(tmp_path / "a.png", colours)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png"), colours[:, :, 2::-1])
    cv2.imwrite(str(tmp_path / "deep.png"), colours[:, :, 0].astype(np.uint16) * 257 + 100)
    np.testing.assert_array_equal(read_picture(tmp_path / "deep.png"), colours[:, :, :1].repeat(3, axis=2))


def test_levels_are_not_rounded(tmp_path: Path, rng: np.random.Generator) -> None:
    """16 bits stay 16 bits, three equal channels are one, and colours are no levels."""
    deep = rng.integers(0, 1 << 16, (4, 3), dtype=np.uint16)
    cv2.imwrite(str(tmp_path / "deep.png"), deep)
    np.testing.assert_array_equal(read_levels(tmp_path / "deep.png"), deep)
    write_png(tmp_path / "grey.png", np.full((2, 2, 3), 7, np.uint8))
    assert (read_levels(tmp_path / "grey.png") == 7.0).all()
    write_png(tmp_path / "red.png", np.full((2, 2, 3), (0, 0, 9), np.uint8))
    with pytest.raises(DvcError, match="got colours"):
        read_levels(tmp_path / "red.png")


@pytest.mark.parametrize(
    "read",
    [read_picture, read_levels, lambda path: read_plane(path, 1, (2, 2))],
    ids=["picture", "levels", "plane"],
)
@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n", b"text"])
def test_other_files_are_refused(tmp_path: Path, read: Callable[[Path], Any], content: bytes) -> None:
    (tmp_path / "x.png").write_bytes(content)
    with pytest.raises(DvcError, match=r"x\.png"):
        read(tmp_path / "x.png")


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".webp", ".jpg", ".bmp", ".pgm"])
def test_stated_sizes_are_bounded_before_decoding(tmp_path: Path, suffix: str) -> None:
    """Files that state too many pixels are refused with one line, without their memory."""
    path = tmp_path / f"x{suffix}"
    if suffix == ".png":
        content = cv2.imencode(suffix, np.zeros((2, 2), np.uint8))[1].tobytes()
        header = b"IHDR" + struct.pack(">II", 16384, 4097) + content[24:29]
        path.write_bytes(content[:12] + header + struct.pack(">I", zlib.crc32(header)) + content[33:])
    elif suffix == ".pgm":
        path.write_bytes(b"P5 16384 4097 255\n")
    else:
        path.write_bytes(cv2.imencode(suffix, np.zeros((8193, 8193), np.uint8))[1].tobytes())
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for read in (read_picture, read_levels, largest_level, lambda path: read_plane(path, 1, (2, 2))):
        with pytest.raises(DvcError, match=rf"x{suffix}: pictures of more than 67108864 pixels are not"):
            read(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 64 << 10


def test_long_sides_are_refused(tmp_path: Path) -> None:
    (tmp_path / "x.pgm").write_bytes(b"P5 16385 1 255\n" + bytes(16385))
    with pytest.raises(DvcError, match=r"x\.pgm: 16385x1 pictures are not supported"):
        read_levels(tmp_path / "x.pgm")


def test_planes_of_other_kinds_are_refused(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.zeros((3, 2), np.uint8))
    for channels, shape in ((1, (2, 3)), (4, (3, 2))):
        with pytest.raises(DvcError, match="not an eight-bit"):
            read_plane(tmp_path / "a.png", channels, shape)
    with pytest.raises(DvcError, match="cannot write"):
        write_png(tmp_path / "b.png", np.zeros((0, 2), np.uint8))
