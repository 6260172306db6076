"""Methods of side information and coders of planes that other packages register by entry points."""

import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from dvc.errors import ConfigError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")

NAME: Final = re.compile(r"[a-z0-9_-]{1,32}")
"""Names that streams can hold; the tests of `dvc.contracts` report all other names, which are ignored."""
SIDE_INFORMATION = "dvc3d.side_information"
PLANE_CODERS = "dvc3d.plane_coders"
GROUPS = SIDE_INFORMATION, PLANE_CODERS
"""Groups of entry points."""


@cache
def installed(group: str) -> "Mapping[str, EntryPoint]":
    """Return the entry points of a group by name, without importing any of them."""
    from importlib.metadata import entry_points

    found = sorted(entry_points(group=group), key=lambda entry: entry.name)
    return {entry.name: entry for entry in found if NAME.fullmatch(entry.name)}


def make(group: str, name: str, *arguments: Any) -> Any:
    """Import the factory of a name, and call it."""
    return _guarded(group, name, "made", _load(group, name), *arguments)


def maker(group: str, name: str) -> Callable[..., Any]:
    """Import the factory of a name, and return a function that calls it."""
    _load(group, name)
    return partial(make, group, name)


def _load(group: str, name: str) -> Any:
    return _guarded(group, name, "imported", installed(group)[name].load)


def _guarded(group: str, name: str, done: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function of an extension; the error for any exception names it and its package."""
    try:
        return function(*arguments)
    except Exception as err:  # an extension may raise anything
        entry = installed(group)[name]
        package = entry.dist.name if entry.dist else entry.value
        problem = f"cannot be {done}: {type(err).__name__}: {err}"
        raise ConfigError(f"extension {name!r} of {package} {problem}") from err


class Registry(Mapping[str, T], Generic[T]):
    """Built-in objects by name, then those of extensions, which cannot take names of built-in ones."""

    def __init__(self, group: str, builtin: Mapping[str, T], make: Callable[[str], T]) -> None:
        self._group, self._builtin, self._make = group, builtin, make

    def __getitem__(self, name: str) -> T:
        if name in self._builtin:
            return self._builtin[name]
        if name not in installed(self._group):
            raise KeyError(name)
        return self._make(name)

    def __contains__(self, name: object) -> bool:
        return name in self._builtin or name in installed(self._group)

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*self._builtin, *installed(self._group))))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def missing(self, name: str) -> str:
        """Return the message about a name that is neither built in nor installed."""
        kind = self._group.partition(".")[2].replace("_", " ").removesuffix("s")
        return f"{kind} {name} is not installed; available: {', '.join(self)}"
