"""Units of elementary streams."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.errors import BitstreamError
from dvc.rd.anchors.bitstream import nal_units, picture_bytes, without_overhead

SPS, SEI, SLICE = (b"\0\0\0\1" + bytes([first, 0x80]) for first in (0x67, 0x06, 0x65))


def test_units_keep_their_start_codes() -> None:
    """Units of three and four bytes of start code together make the stream."""
    assert nal_units(SPS + SLICE[1:] + SEI) == [SPS, SLICE[1:], SEI]
    assert nal_units(b"") == []


def test_messages_and_known_parameter_sets_are_left_out() -> None:
    """What a decoder has or does not need is not written, whatever the length of its start code."""
    assert without_overhead(SPS + SEI + SLICE, "h264") == SPS + SLICE
    assert without_overhead(SPS[1:] + SEI + SLICE, "h264", known=SPS) == SLICE
    assert without_overhead(b"\x12\0", "obu") == b"\x12\0"


def test_slices_are_counted() -> None:
    """Only slices count as picture."""
    assert picture_bytes(SPS + SEI + SLICE, "h264") == len(SLICE)
    assert picture_bytes(b"\0\0\1\x26\1\xff" + b"\0\0\1\x42\1", "hevc") == 6


def test_frames_of_av1_are_counted() -> None:
    """A temporal delimiter, a sequence header of two bytes and a frame of three bytes."""
    stream = b"\x12\0" + b"\x0a\2ab" + b"\x32\3abc"
    assert picture_bytes(stream, "obu") == 5


@pytest.mark.parametrize("stream", [b"\x12", b"\x32\5abc", b"\x32\x80", b"\x32" + b"\xff" * 9])
def test_wrong_lengths_are_refused(stream: bytes) -> None:
    """A unit of AV1 that is cut or has no length raises BitstreamError."""
    with pytest.raises(BitstreamError, match="AV1"):
        picture_bytes(stream, "obu")


@given(st.binary(max_size=60), st.sampled_from(["h264", "hevc", "obu"]))
def test_any_bytes_are_counted_or_refused(stream: bytes, file_format: str) -> None:
    """Arbitrary bytes give a count within their length, or BitstreamError."""
    try:
        assert 0 <= picture_bytes(stream, file_format) <= len(stream)
    except BitstreamError:
        return
