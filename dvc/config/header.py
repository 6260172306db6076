"""The configuration as bytes of a stream header: MessagePack arrays of what differs from the defaults."""

from dataclasses import fields
from typing import Any

import msgspec

from dvc.config.codec import CodecConfig
from dvc.config.fields import Section, check_choice, field_types, is_section, shown
from dvc.config.sections import CODERS, DEFAULT_CODER, CoderConfig
from dvc.errors import BitstreamError, ConfigError


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
    for field in fields(section):
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
        values = msgspec.msgpack.decode(data)
        config = CodecConfig.from_dict(_table(CodecConfig, values, "configuration"))
    except (ConfigError, msgspec.DecodeError, TypeError, UnicodeDecodeError, RecursionError) as err:
        raise BitstreamError(f"configuration: {err}") from err
    if encode_config(config) != data:
        raise BitstreamError("configuration: not in its one form")
    return config


def _table(section: type[Section], values: Any, name: str) -> dict[str, Any]:
    """Return the fields of a section that are not left out, for `Section.from_dict`."""
    if not isinstance(values, list):
        raise ConfigError(f"`{name}` must be an array, got {shown(values)}")
    types = field_types(section)
    if section is CoderConfig:
        coder = (values or [None])[0] or DEFAULT_CODER
        if not isinstance(coder, str):
            raise ConfigError(f"`name` of a coder must be a string, got {shown(coder)}")
        check_choice("coder", coder, CODERS)
        types = {"name": str, **field_types(CODERS[coder])}
    if len(values) > len(types):
        raise ConfigError(f"`{name}` has {len(values)} values, {len(types)} known: made by a newer program?")
    return {
        field: _table(hint, value, field) if is_section(hint) else value
        for (field, hint), value in zip(types.items(), values, strict=False)
        if value is not None
    }
