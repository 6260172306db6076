"""Common part of all sections of a configuration: checked fields, and a form for JSON."""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, dataclass, fields
from functools import cache
from typing import Any, Self, TypeGuard, get_type_hints

import msgspec

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


field_types: Callable[[Any], Mapping[str, Any]] = cache(get_type_hints)
"""Types of a section's fields by name."""


def is_section(hint: Any) -> "TypeGuard[type[Section]]":
    """Return whether the type of a field is a section."""
    return isinstance(hint, type) and issubclass(hint, Section)


def _converted(name: str, value: Any, hint: Any) -> Any:
    """Return a value of the type of a field, made from its JSON form if need be."""
    if is_section(hint):
        return value if isinstance(value, hint) else hint.from_dict(value, name)
    try:
        result = msgspec.convert(value, hint)
    except (msgspec.ValidationError, OverflowError) as err:
        raise ConfigError(f"`{name}` is {shown(value)}: {err}") from err
    if isinstance(result, float) and not math.isfinite(result):
        raise ConfigError(f"`{name}` must be a finite number, got {shown(value)}")
    return result


@dataclass(frozen=True)
class Section:
    """Part of a configuration: each field has its type, and the values pass the checks of the section."""

    def __post_init__(self) -> None:
        for name, hint in field_types(type(self)).items():
            object.__setattr__(self, name, _converted(name, getattr(self, name), hint))
        self._check_values()

    def _check_values(self) -> None:
        """Raise `ConfigError` for values that make no sense; the types are right already."""

    def to_dict(self) -> dict[str, Any]:
        """Return the section as JSON-safe values; inverse of `from_dict`."""
        return {name: _to_json(getattr(self, name)) for name in field_types(type(self))}

    @classmethod
    def from_dict(cls, values: Any, name: str = "configuration") -> Self:
        """Build the section from a table of fields; those that are left out take their defaults."""
        if not isinstance(values, dict):
            raise ConfigError(f"`{name}` must be a table of fields, got {shown(values)}")
        defaults = {field.name: field.default for field in fields(cls)}
        for key in values:
            if key not in defaults:
                raise ConfigError(f"`{name}` has no field {shown(key)}; fields are {', '.join(defaults)}")
        for key, default in defaults.items():
            if default is MISSING and key not in values:
                raise ConfigError(f"`{name}` lacks the field `{key}`")
        return cls(**values)


def _to_json(value: Any) -> Any:
    if isinstance(value, Section):
        return value.to_dict()
    return list(value) if isinstance(value, tuple) else msgspec.to_builtins(value)
