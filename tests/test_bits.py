"""Bits and variable-length integers."""

from itertools import chain

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.bits import (
    MAX_VARINT,
    BitReader,
    decode_bytes,
    decode_varint,
    encode_varint,
    pack_digits,
)
from dvc.errors import BitstreamError


@given(st.lists(st.lists(st.integers(0, 1)), min_size=1))
def test_reader_gives_back_what_was_packed(parts: list[list[int]]) -> None:
    reader = BitReader(np.packbits(np.array([*chain(*parts)], np.uint8)).tobytes())
    for part in parts:
        assert reader.read(len(part)).tolist() == part
    assert reader.num_left == -sum(map(len, parts)) % 8


@given(st.lists(st.integers(0, 1)))
def test_digits_are_bits(digits: list[int]) -> None:
    assert pack_digits("".join(map(str, digits))) == np.packbits(np.array(digits, np.uint8)).tobytes()


def test_reader_is_exhausted_with_its_bytes() -> None:
    reader = BitReader(b"\xa5")
    assert reader.read(3).tolist() == [1, 0, 1]
    with pytest.raises(BitstreamError, match="6 bits wanted, 5 left"):
        reader.read(6)
    with pytest.raises(ValueError, match="must not be negative"):
        reader.read(-1)
    assert reader.read(5).tolist() == [0, 0, 1, 0, 1]
    assert reader.num_left == 0
    assert reader.read(0).size == 0


def test_short_reads_unpack_no_more_than_their_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    few = [np.array([number >> 1, number & 1], np.uint8) for number in range(4)]
    reader = BitReader(np.packbits([few[number & 3] for number in range(2000)]).tobytes())
    unpacked, unpackbits = [], np.unpackbits
    monkeypatch.setattr(np, "unpackbits", lambda octets: unpacked.append(octets.size) or unpackbits(octets))
    assert all((reader.read(2) == few[number & 3]).all() for number in range(2000))
    assert unpacked == [1] * 2000


@given(st.integers(0, MAX_VARINT), st.binary(max_size=8))
def test_varints_come_back(value: int, tail: bytes) -> None:
    data = encode_varint(value)
    assert len(data) == max(1, -(-value.bit_length() // 7))
    assert decode_varint(b"\xff" + data + tail, 1) == (value, 1 + len(data))


def test_varints_of_the_textbook() -> None:
    """The example of the DWARF standard for LEB128."""
    assert encode_varint(624485) == b"\xe5\x8e\x26"


@pytest.mark.parametrize("value", [-1, MAX_VARINT + 1, 2**9000])
def test_varints_out_of_range_are_refused(value: int) -> None:
    with pytest.raises(ValueError, match="`value`"):
        encode_varint(value)


@pytest.mark.parametrize(
    "data", [b"", b"\x80", b"\xff" * 4, b"\x80\x00", b"\xff\x80\x00", b"\xff" * 5, b"\x80" * 9]
)
def test_malformed_varints_are_refused(data: bytes) -> None:
    with pytest.raises(BitstreamError, match="integer"):
        decode_varint(data, 0)


def test_counted_bytes() -> None:
    assert decode_bytes(b"?\x03abcd", 1) == (b"abc", 5)
    with pytest.raises(BitstreamError, match="3 bytes promised, 2 left"):
        decode_bytes(b"\x03ab", 0)
