"""Sizes that picture files state are those that they are decoded to."""

import struct

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.picture_sizes import stated_size

KINDS = [
    (".png", []),
    (".jpg", []),
    (".jpg", [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]),
    (".tiff", []),
    (".webp", [cv2.IMWRITE_WEBP_QUALITY, 50]),
    (".webp", [cv2.IMWRITE_WEBP_QUALITY, 101]),
]


def encoded(suffix: str, options: list[int], picture: np.ndarray) -> bytes:
    """Return a picture as a file."""
    done, content = cv2.imencode(suffix, picture, options)
    assert done
    return content.tobytes()


@pytest.mark.parametrize(("suffix", "options"), KINDS)
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_sizes_are_those_of_the_picture(suffix: str, options: list[int], channels: int) -> None:
    """Grey, in colour, and with opacity."""
    shape = (37, 300, channels)
    picture = np.random.default_rng(1).integers(0, 256, shape, np.uint8).squeeze()
    content = encoded(suffix, options, picture)
    assert stated_size(content) == (300, 37)


def test_long_numbers_of_tiff() -> None:
    """Most significant byte first, and with addresses of 64 bits."""
    entries = struct.pack(">HHQQ", 256, 16, 1, 70000) + struct.pack(">HHQHHI", 257, 3, 1, 9, 0, 0)
    content = b"MM\0+" + struct.pack(">HHQQ", 8, 0, 16, 2) + entries
    assert stated_size(content) == (70000, 9)


@pytest.mark.parametrize(
    "content", [b"", b"P5 3 3 255\n", b"RIFF....WEBPVP9 ", b"\x89PNG\r\n\x1a\n", b"II*\0"]
)
def test_others_state_none(content: bytes) -> None:
    """Other kinds, and files that are cut."""
    assert stated_size(content) is None


@given(
    st.sampled_from([b"\xff\xd8", b"II*\0\x08\0\0\0", b"MM\0+", b"RIFF....WEBPVP8X"]), st.binary(max_size=99)
)
def test_any_bytes_are_read(start: bytes, rest: bytes) -> None:
    """What is damaged raises nothing."""
    size = stated_size(start + rest)
    assert size is None or len(size) == 2
