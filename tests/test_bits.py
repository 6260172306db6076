"""Bits and variable-length integers."""

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.bits import MAX_VARINT, BitReader, BitWriter, decode_bytes, decode_varint, encode_varint, pack_digits
from dvc.errors import BitstreamError


@given(st.lists(st.lists(st.integers(0, 1))))
def test_reader_gives_back_what_was_written(parts: list[list[int]]) -> None:
    """Arrays come back in order, and nothing is left but padding."""
    writer = BitWriter()
    for part in parts:
        writer.write(np.array(part, np.uint8))
    data = writer.to_bytes()
    assert len(data) == -(-writer.num_bits // 8)
    assert data == writer.to_bytes()
    reader = BitReader(data)
    for part in parts:
        assert reader.read(len(part)).tolist() == part
    reader.expect_end()


@given(st.lists(st.integers(0, 1)))
def test_digits_are_bits(digits: list[int]) -> None:
    """What is spelled is what a writer of the same bits writes."""
    writer = BitWriter()
    writer.write(np.array(digits, np.uint8))
    assert pack_digits("".join(map(str, digits))) == writer.to_bytes()


def test_writer_refuses_what_are_not_bits() -> None:
    """Other types, shapes and values are errors of the caller, and write nothing."""
    writer = BitWriter()
    for bits in (np.array([2], np.uint8), np.zeros((2, 2), np.uint8)):
        with pytest.raises(ValueError, match="`bits`"):
            writer.write(bits)
    for wrong in ([0, 1], np.zeros(3, np.int64), np.zeros(3, bool)):
        with pytest.raises(TypeError, match="`bits`"):
            writer.write(wrong)  # type: ignore[arg-type]
    assert (writer.num_bits, writer.to_bytes()) == (0, b"")


def test_writer_keeps_no_hold_of_an_array() -> None:
    """Changing an array after it was written changes nothing."""
    bits = np.ones(8, np.uint8)
    writer = BitWriter()
    writer.write(bits)
    bits[:] = 0
    assert writer.to_bytes() == b"\xff"


def test_reader_is_exhausted_with_its_bytes() -> None:
    """Reading on beyond the end raises, and does not move."""
    reader = BitReader(b"\xa5")
    assert reader.read(3).tolist() == [1, 0, 1]
    with pytest.raises(BitstreamError, match="6 bits wanted, 5 left"):
        reader.read(6)
    with pytest.raises(ValueError, match="must not be negative"):
        reader.read(-1)
    assert reader.read(5).tolist() == [0, 0, 1, 0, 1]
    assert reader.num_left == 0
    assert reader.read(0).size == 0


@pytest.mark.parametrize(("data", "num_read"), [(b"\x01", 3), (b"\x00\x00", 8), (b"\x80", 0)])
def test_padding_is_less_than_a_byte_of_zeros(data: bytes, num_read: int) -> None:
    """Anything else at the end is refused."""
    reader = BitReader(data)
    reader.read(num_read)
    with pytest.raises(BitstreamError):
        reader.expect_end()


def test_many_short_writes_take_linear_time() -> None:
    """Twenty thousand writes and reads of a few bits take no more than seconds."""
    writer = BitWriter()
    start_s = time.monotonic()
    few = [np.array([number >> 1, number & 1], np.uint8) for number in range(4)]
    for number in range(20000):
        writer.write(few[number & 3])
    reader = BitReader(writer.to_bytes())
    assert all((reader.read(2) == few[number & 3]).all() for number in range(20000))
    assert time.monotonic() - start_s < 10


@given(st.integers(0, MAX_VARINT), st.binary(max_size=8))
def test_varints_come_back(value: int, tail: bytes) -> None:
    """A varint is as short as seven bits a byte allow, and tells its own length."""
    data = encode_varint(value)
    assert len(data) == max(1, -(-value.bit_length() // 7))
    assert decode_varint(b"\xff" + data + tail, 1) == (value, 1 + len(data))


def test_varints_of_the_textbook() -> None:
    """The example of the DWARF standard for LEB128."""
    assert encode_varint(624485) == b"\xe5\x8e\x26"


@pytest.mark.parametrize("value", [-1, MAX_VARINT + 1, 2**9000])
def test_varints_out_of_range_are_refused(value: int) -> None:
    """Five bytes are the limit."""
    with pytest.raises(ValueError, match="`value`"):
        encode_varint(value)


@pytest.mark.parametrize(
    "data", [b"", b"\x80", b"\xff" * 4, b"\x80\x00", b"\xff\x80\x00", b"\xff" * 5, b"\x80" * 9]
)
def test_malformed_varints_are_refused(data: bytes) -> None:
    """Cut, needlessly long and endless integers are no integers."""
    with pytest.raises(BitstreamError, match="integer"):
        decode_varint(data, 0)


def test_counted_bytes() -> None:
    """Bytes behind their number are bounded by the caller and by what is there."""
    assert decode_bytes(b"?\x03abcd", 1, 3) == (b"abc", 5)
    with pytest.raises(BitstreamError, match="3 bytes where at most 2 are allowed"):
        decode_bytes(b"\x03abc", 0, 2)
    with pytest.raises(BitstreamError, match="3 bytes promised, 2 left"):
        decode_bytes(b"\x03ab", 0, 9)
