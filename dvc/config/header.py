"""The configuration as bytes of a stream header, where only what differs from the defaults is written.

A new field is one line in its dataclass (`dvc.config.sections`) and one number in `FIELD_NUMBERS`.
"""

import struct
from collections.abc import Iterator
from dataclasses import fields
from functools import cache
from operator import attrgetter
from typing import Any

from dvc.config.codec import CodecConfig
from dvc.config.coders import CODERS, DEFAULT_CODER, CoderConfig
from dvc.config.fields import type_hints_of
from dvc.config.sections import MAX_PARAMETER_SETS_BYTES
from dvc.errors import BitstreamError, ConfigError

FIELD_NUMBERS = {
    "codec": 0,
    "seed": 1,
    "video.width": 2,
    "video.height": 3,
    "video.frame_rate_num": 4,
    "video.frame_rate_den": 5,
    "video.luma_only": 6,
    "gop.length": 8,
    "gop.references": 9,
    "key.qp": 16,
    "key.lossless": 17,
    "key.intra_period": 18,
    "key.parameter_sets": 19,
    "wyner_ziv.levels": 24,
    "wyner_ziv.noise_model": 25,
    "wyner_ziv.qp": 26,
    "wyner_ziv.priors": 28,
    "wyner_ziv.limited": 29,
    "coder.name": 40,
    "coder.batch_percent": 41,
    "side_information.method": 56,
    "side_information.track_corrections": 57,
    "side_information.fallback": 58,
    "geometry.backend": 72,
    "geometry.path_regularity": 73,
    "tracks.kind": 80,
    "tracks.num_points": 81,
    "tracks.subpixel_bits": 82,
}
"""Number of every field in a stream header."""

_PATHS = {number: path for path, number in FIELD_NUMBERS.items()}
_MAX_TEXT_BYTES = 64
_MAX_TUPLE_LENGTH = 64


@cache
def _leaf(path: str) -> tuple[Any, Any]:
    """Return the type of a field and its default, `MISSING` if it has none."""
    if path == "coder.name":
        return str, DEFAULT_CODER
    section: Any = CodecConfig
    *parents, name = path.split(".")
    for parent in parents:
        section = type_hints_of(section)[parent]
    if section is CoderConfig:
        section = next(coder for coder in CODERS.values() if name in type_hints_of(coder))
    (field,) = (field for field in fields(section) if field.name == name)
    return type_hints_of(section)[name], field.default


def _encode_value(value: Any) -> bytes:
    from dvc.bits import encode_varint

    if isinstance(value, float):
        return struct.pack("<d", value)
    if isinstance(value, str):
        value = value.encode("ascii")
    if isinstance(value, bytes):
        return encode_varint(len(value)) + value
    if isinstance(value, tuple):
        return encode_varint(len(value)) + b"".join(encode_varint(item) for item in value)
    return encode_varint(int(value))


def _decode_value(data: bytes, position: int, hint: Any) -> tuple[Any, int]:
    from dvc.bits import decode_bytes, decode_varint

    if hint is float:
        (number,) = struct.unpack_from("<d", data, position)
        return number, position + 8
    if hint is str:
        text, position = decode_bytes(data, position, _MAX_TEXT_BYTES)
        return text.decode("ascii"), position
    if hint is bytes:
        return decode_bytes(data, position, MAX_PARAMETER_SETS_BYTES)
    value, position = decode_varint(data, position)
    if hint is bool and value <= 1:
        return bool(value), position
    if hint is not int and hint is not bool:
        if value > _MAX_TUPLE_LENGTH:
            raise BitstreamError(f"{value} entries where at most {_MAX_TUPLE_LENGTH} are allowed")
        items = []
        for _ in range(value):
            item, position = decode_varint(data, position)
            items.append(item)
        return tuple(items), position
    return value, position


def _value(config: CodecConfig, path: str, default: Any) -> Any:
    """Return the value of a field; a coder has not the fields of others."""
    *parents, name = path.split(".")
    return getattr(attrgetter(".".join(parents))(config) if parents else config, name, default)


def encode_config(config: CodecConfig) -> bytes:
    """Write a configuration for a stream header; inverse of `decode_config`.

    Each field that differs from its default, in increasing order of its number: the number, then the value,
    both as `docs/bitstream.md` states. A configuration has exactly one such form.

    Parameters
    ----------
    config : CodecConfig
        The configuration.

    Returns
    -------
    bytes
        About 15 bytes, and what differs from the defaults.
    """
    from dvc.bits import encode_varint

    parts = []
    for path, number in FIELD_NUMBERS.items():
        default = _leaf(path)[1]
        value = _value(config, path, default)
        if value != default:
            parts.append(encode_varint(number) + _encode_value(value))
    return b"".join(parts)


def _decode_fields(data: bytes) -> Iterator[tuple[str, Any]]:
    from dvc.bits import decode_varint

    position, last = 0, -1
    while position < len(data):
        number, position = decode_varint(data, position)
        if number not in _PATHS:
            raise BitstreamError(f"configuration field {number} is unknown: made by a newer program?")
        if number <= last:
            raise BitstreamError(f"configuration field {number} follows field {last}")
        path = _PATHS[number]
        hint, default = _leaf(path)
        try:
            value, position = _decode_value(data, position, hint)
        except (struct.error, UnicodeDecodeError, BitstreamError) as err:
            raise BitstreamError(f"configuration field `{path}`: {err}") from err
        if value == default:
            raise BitstreamError(f"configuration field `{path}` restates its default")
        last = number
        yield path, value


def decode_config(data: bytes) -> CodecConfig:
    """Read a configuration from a stream header; inverse of `encode_config`.

    Parameters
    ----------
    data : bytes
        As `encode_config` returns it.

    Returns
    -------
    CodecConfig
        The configuration.

    Raises
    ------
    BitstreamError
        If the bytes are damaged, of a newer program, or hold values that make no sense.
    """
    values: dict[str, Any] = {}
    for path, value in _decode_fields(data):
        *parents, name = path.split(".")
        section = values
        for parent in parents:
            section = section.setdefault(parent, {})
        section[name] = value
    try:
        return CodecConfig.from_dict(values)
    except ConfigError as err:
        raise BitstreamError(f"configuration: {err}") from err
