"""Bits, and integers of variable length, in bytes."""

import numpy as np
from numpy.typing import NDArray

from dvc.errors import BitstreamError

MAX_VARINT_BYTES = 5
MAX_VARINT = 2 ** (7 * MAX_VARINT_BYTES) - 1


def encode_varint(value: int) -> bytes:
    """Write an integer seven bits a byte, lowest first, top bit set in all bytes but the last (LEB128)."""
    if not 0 <= value <= MAX_VARINT:
        raise ValueError(f"`value` must be in [0, 2**35), got {value.bit_length()} bits, sign {value < 0:d}")
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)


def decode_varint(data: bytes | bytearray | memoryview, position: int) -> tuple[int, int]:
    """Read an integer that `encode_varint` wrote."""
    value = 0
    for count in range(MAX_VARINT_BYTES):
        if position + count >= len(data):
            raise BitstreamError("data end within an integer")
        byte = data[position + count]
        value |= (byte & 0x7F) << (7 * count)
        if byte <= 0x7F:
            if byte == 0 and count > 0:
                raise BitstreamError("integer is longer than it need be")
            return value, position + count + 1
    raise BitstreamError(f"integer is longer than {MAX_VARINT_BYTES} bytes")


def decode_bytes(data: bytes, position: int) -> tuple[bytes, int]:
    """Read bytes that follow their number as a varint."""
    size, position = decode_varint(data, position)
    if size > len(data) - position:
        raise BitstreamError(f"{size} bytes promised, {len(data) - position} left")
    return data[position : position + size], position + size


def pack_digits(digits: str) -> bytes:
    """Return bytes of the bits of a string of digits."""
    size = -(-len(digits) // 8)
    return int(digits.ljust(8 * size, "0") or "0", 2).to_bytes(size, "big")


class BitReader:
    """Reads bits of bytes, top bits first."""

    def __init__(self, data: bytes) -> None:
        self._octets = np.frombuffer(data, np.uint8)
        self._position = 0

    @property
    def num_left(self) -> int:
        """Number of bits not read yet, padding included."""
        return 8 * self._octets.size - self._position

    def read(self, count: int) -> NDArray[np.uint8]:
        """Read the next bits."""
        if count < 0:
            raise ValueError(f"`count` must not be negative, got {count}")
        if count > self.num_left:
            raise BitstreamError(f"{count} bits wanted, {self.num_left} left")
        first, skip = divmod(self._position, 8)
        self._position += count
        octets = self._octets[first : -(-self._position // 8)]
        return np.unpackbits(octets)[skip : skip + count]

    def read_number(self, count: int) -> int:
        """Read an integer, its top bit first."""
        value = 0
        for bit in self.read(count).tolist():
            value = 2 * value + bit
        return value
