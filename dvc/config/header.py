"""The configuration as bytes of a stream header: MessagePack arrays of what differs from the defaults."""

from dataclasses import fields
from typing import Any

import msgspec

from dvc.config.codec import CodecConfig
from dvc.config.coders import CODERS, DEFAULT_CODER, CoderConfig
from dvc.config.fields import Section, check_choice, is_section, type_hints_of
from dvc.errors import BitstreamError, ConfigError

_NIL = msgspec.msgpack.encode(None)


def encode_config(config: CodecConfig) -> bytes:
    """Write a configuration for a stream header; inverse of `decode_config`.

    A section is an array of its values in the order of its dataclass, that of the coder after its name. Nil
    denotes a default, and a section of defaults; arrays do not end in nil. A configuration
    has exactly one such form, which `docs/bitstream.md` states.

    Parameters
    ----------
    config : CodecConfig
        The configuration.

    Returns
    -------
    bytes
        About 10 bytes, and the values that differ from the defaults.
    """
    return msgspec.msgpack.encode(_values(config))


def _values(section: Section) -> list[Any] | None:
    """Return the values of a section's fields, `None` for defaults; `None` for a section of defaults."""
    values: list[Any] = []
    if isinstance(section, CoderConfig):
        values.append(None if section.name == DEFAULT_CODER else section.name)
    for field in fields(section):  # type: ignore[arg-type]
        value = getattr(section, field.name)
        values.append(
            _values(value) if isinstance(value, Section) else None if value == field.default else value
        )
    while values and values[-1] is None:
        values.pop()
    return values or None


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
    try:
        config = CodecConfig.from_dict(_table(CodecConfig, data, "configuration"))
    except (ConfigError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as err:
        raise BitstreamError(f"configuration: {err}") from err
    if encode_config(config) != data:
        raise BitstreamError("configuration: not in its one form")
    return config


def _table(section: Any, data: bytes | msgspec.Raw, name: str) -> dict[str, Any]:
    """Return the fields of a section that are not left out, for `Section.build`."""
    values = msgspec.msgpack.decode(data, type=list[msgspec.Raw])
    hints = type_hints_of(section)
    if section is CoderConfig:
        coder = (msgspec.msgpack.decode(values[0], type=str | None) if values else None) or DEFAULT_CODER
        check_choice("coder", coder, CODERS)
        hints = {"name": str, **type_hints_of(CODERS[coder])}
    if len(values) > len(hints):
        raise ConfigError(f"`{name}` has {len(values)} values, {len(hints)} known: made by a newer program?")
    return {
        field: _table(hint, value, field) if is_section(hint) else msgspec.msgpack.decode(value, type=hint)
        for (field, hint), value in zip(hints.items(), values, strict=False)
        if bytes(value) != _NIL
    }
