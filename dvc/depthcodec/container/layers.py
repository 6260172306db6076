"""Quality layers: what each adds to the pictures and disparities of those before, and their checksums."""

import zlib
from collections.abc import Sequence
from typing import NamedTuple

from dvc.bits import decode_varint, encode_varint
from dvc.depthcodec.container.header import Header, decode_header, encode_header
from dvc.depthcodec.container.limits import Extent, check_extent
from dvc.errors import BitstreamError

_CRC_BYTES = 4


class PairLayer(NamedTuple):
    """What a layer adds to a picture and its disparities."""

    picture: bytes  # code of each; empty: nothing
    disparity: bytes


Layer = tuple[PairLayer, ...]
"""One entry for each reference."""


class Stream(NamedTuple):
    """A stream, as far as it can be read."""

    header: Header  # what it is
    layers: tuple[Layer, ...]  # the layers that are there and whole, in order
    damage: str | None = None  # why there are no more of them, if there should be


def encode_stream(header: Header, layers: Sequence[Layer]) -> bytes:
    """Return the bytes of a stream."""
    return encode_header(header) + b"".join(encode_layer(layer) for layer in layers)


def encode_layer(layer: Layer) -> bytes:
    """Return the bytes of a layer."""
    data = b"".join(encode_varint(len(part)) + part for pair in layer for part in pair)
    return data + zlib.crc32(data).to_bytes(_CRC_BYTES, "little")


def decode_stream(data: bytes, max_mib: float | None = None) -> Stream:
    """Read a stream; layers that are cut or damaged are left out, with all after them."""
    header, position = decode_header(data)
    layers: list[Layer] = []
    damage = None
    while len(layers) < header.num_layers and damage is None:
        try:
            layer, position = _decode_layer(data, position, len(header.references))
            layers.append(layer)
        except BitstreamError as error:
            damage = f"layer {len(layers) + 1} of {header.num_layers}: {error}"
    if not layers:
        raise BitstreamError(str(damage))
    if damage is None and position != len(data):
        damage = f"{len(data) - position} bytes follow the last layer"
    size = header.shape[0] * header.shape[1]
    held = size * len(header.references)
    check_extent(Extent(size, held, held * len(layers)), len(data), max_mib)
    return Stream(header, tuple(layers), damage)


def _decode_layer(data: bytes, start: int, num_pairs: int) -> tuple[Layer, int]:
    parts = []
    position = start
    for _ in range(2 * num_pairs):
        try:
            size, position = decode_varint(data, position)
        except BitstreamError:
            raise BitstreamError(f"the stream ends within it, after {len(data)} bytes") from None
        if size > len(data) - position:
            raise BitstreamError(f"the stream ends within it, after {len(data)} bytes")
        parts.append(data[position : position + size])
        position += size
    checksum = data[position : position + _CRC_BYTES]
    if len(checksum) < _CRC_BYTES:
        raise BitstreamError(f"the stream ends within it, after {len(data)} bytes")
    if zlib.crc32(data[start:position]).to_bytes(_CRC_BYTES, "little") != checksum:
        raise BitstreamError(f"it is damaged, between bytes {start} and {position}")
    pairs = tuple(PairLayer(*pair) for pair in zip(parts[::2], parts[1::2], strict=True))
    return pairs, position + _CRC_BYTES
