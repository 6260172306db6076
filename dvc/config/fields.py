"""Common part of all sections of a configuration: checked fields, and a form for JSON."""

import base64
import binascii
import math
from collections.abc import Collection, Mapping
from dataclasses import MISSING, fields
from functools import cache
from types import MappingProxyType
from typing import Any, Self, TypeGuard, get_type_hints

from dvc.errors import ConfigError
from dvc.extensions import Registry


def shown(value: object) -> str:
    """Write a value into a message, cut short if it is long."""
    if isinstance(value, int) and value.bit_length() > 64:
        return f"a number of {value.bit_length()} bits"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Refuse a number out of range."""
    if not low <= value <= high:
        raise ConfigError(f"`{name}` must be from {low} to {high}, got {shown(value)}")


def check_choice(name: str, value: str, choices: Collection[str]) -> None:
    """Refuse a name that is not among the choices."""
    if value not in choices:
        if isinstance(choices, Registry):
            raise ConfigError(choices.missing(shown(value)))
        raise ConfigError(f"`{name}` must be one of {', '.join(choices)}, got {shown(value)}")


def type_hints_of(section: Any) -> Mapping[str, Any]:
    """Return the types of a section's fields."""
    return _type_hints(section)


@cache
def _type_hints(section: Any) -> Mapping[str, Any]:
    return MappingProxyType(get_type_hints(section))


def _check_type(name: str, value: object, hint: Any) -> None:
    if hint == tuple[int, ...]:
        good = isinstance(value, tuple) and all(type(item) is int for item in value)
        expected = "a sequence of integers"
    elif hint is float:
        good = type(value) is float and math.isfinite(value)
        expected = "a finite number"
    else:
        good = isinstance(value, hint) if is_section(hint) else type(value) is hint
        expected = f"of type {hint.__name__}"
    if not good:
        raise ConfigError(f"`{name}` must be {expected}, got {shown(value)}")


class Section:
    """Check the type of every field, then the conditions of the section."""

    def __post_init__(self) -> None:
        for name, hint in type_hints_of(type(self)).items():
            value = getattr(self, name)
            if hint is float and type(value) is int and abs(value) < 2**53:
                value = float(value)
                object.__setattr__(self, name, value)
            _check_type(name, value, hint)
        self._check_values()

    def _check_values(self) -> None:
        """Raise `ConfigError` for values that make no sense; the types are right already."""

    def to_dict(self) -> dict[str, Any]:
        """Return the section as JSON-safe values; inverse of `from_dict`."""
        return {name: _to_json(getattr(self, name)) for name in type_hints_of(type(self))}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """Rebuild the section from JSON-safe values; fields that are left out take their defaults."""
        return cls.build(values, "configuration")

    @classmethod
    def build(cls, values: Any, name: str) -> Self:
        """Build the section from a dictionary of JSON values or of the fields themselves."""
        built = _build(cls, values, name)
        assert isinstance(built, cls)
        return built


def is_section(hint: Any) -> TypeGuard[type[Section]]:
    """Return whether the type of a field is a section."""
    return isinstance(hint, type) and issubclass(hint, Section)


def _to_json(value: Any) -> Any:
    if isinstance(value, Section):
        return value.to_dict()
    if isinstance(value, bytes):
        return base64.b64encode(value).decode("ascii")
    return list(value) if isinstance(value, tuple) else value


def _from_json(name: str, value: Any, hint: Any) -> Any:
    if hint is bytes and isinstance(value, str):
        try:
            return base64.b64decode(value, validate=True)
        except (binascii.Error, ValueError) as err:
            raise ConfigError(f"`{name}` must be base64, got {shown(value)}") from err
    return tuple(value) if isinstance(value, list) else value


def _build(section: Any, values: Any, name: str) -> Any:
    """Build a section from a dictionary of JSON values or of the fields themselves."""
    if not isinstance(values, dict):
        raise ConfigError(f"`{name}` must be a table of fields, got {shown(values)}")
    hints = type_hints_of(section)
    unknown = [key for key in values if key not in hints]
    if unknown:
        raise ConfigError(f"`{name}` has no field {shown(unknown[0])}; fields are {', '.join(hints)}")
    arguments: dict[str, Any] = {}
    for field in fields(section):
        if field.name not in values:
            if field.default is MISSING:
                raise ConfigError(f"`{name}` lacks the field `{field.name}`")
            continue
        hint, value = hints[field.name], values[field.name]
        arguments[field.name] = (
            hint.build(value, field.name) if is_section(hint) else _from_json(field.name, value, hint)
        )
    return section(**arguments)
