"""Extensions: what other packages register by entry points, known by name and imported when it is used."""

import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from dvc.errors import ConfigError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")

NAME: Final = re.compile(r"[a-z0-9_-]{1,32}")
"""What can stand in streams; other names are left aside, and `dvc.contracts` tells their authors."""

SIDE_INFORMATION = "dvc3d.side_information"
SCENE_INTERPOLATORS = "dvc3d.scene_interpolators"
NOISE_MODELS = "dvc3d.noise_models"
PLANE_CODERS = "dvc3d.plane_coders"
INFERENCE = "dvc3d.inference"
DISPARITY_CODECS = "dvc3d.disparity_codecs"
GROUPS = SIDE_INFORMATION, SCENE_INTERPOLATORS, NOISE_MODELS, PLANE_CODERS, INFERENCE, DISPARITY_CODECS
"""Groups of entry points."""


@cache
def installed(group: str) -> "Mapping[str, EntryPoint]":
    """Return the entry points of a group by name, none of which is imported for it."""
    from importlib.metadata import entry_points

    found = sorted(entry_points(group=group), key=lambda entry: entry.name)
    return {entry.name: entry for entry in found if NAME.fullmatch(entry.name)}


def load(group: str, name: str) -> Any:
    """Import what is registered under a name."""
    try:
        return installed(group)[name].load()
    except Exception as err:  # an extension may raise anything
        raise _unusable(group, name, "imported", err) from err


def maker(group: str, name: str) -> Callable[..., Any]:
    """Import what is registered under a name; what is returned makes it."""
    load(group, name)
    return partial(make, group, name)


def make(group: str, name: str, *arguments: Any) -> Any:
    """Import what is registered under a name, and call it."""
    factory = load(group, name)
    try:
        return factory(*arguments)
    except Exception as err:
        raise _unusable(group, name, "made", err) from err


def _unusable(group: str, name: str, done: str, err: Exception) -> ConfigError:
    """Return the error that names an extension and its package."""
    entry = installed(group)[name]
    package = entry.dist.name if entry.dist else entry.value
    return ConfigError(f"extension {name!r} of {package} cannot be {done}: {type(err).__name__}: {err}")


class Registry(Mapping[str, T], Generic[T]):
    """What there is by name: our own, then what is installed; names of ours cannot be taken."""

    def __init__(self, group: str, own: dict[str, T], make: Callable[[str], T] | None = None) -> None:
        self._group, self.own = group, own
        self._make = make or (lambda name: load(group, name))

    def __getitem__(self, name: str) -> T:
        if name in self.own:
            return self.own[name]
        if name not in installed(self._group):
            raise KeyError(name)
        return self._make(name)

    def __contains__(self, name: object) -> bool:
        return name in self.own or name in installed(self._group)

    def __iter__(self) -> Iterator[str]:
        yield from self.own
        yield from (name for name in installed(self._group) if name not in self.own)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def missing(self, name: str) -> str:
        """Say that what a stream or user names, as a message shows it, is neither ours nor installed."""
        kind = self._group.partition(".")[2].replace("_", " ").removesuffix("s")
        return f"{kind} {name} is not installed; there are {', '.join(self)}"
