"""Extensions: what other packages register by entry points, known by name and imported when it is used."""

import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from dvc.errors import ConfigError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

T = TypeVar("T")

NAME: Final = re.compile(r"[a-z0-9_-]{1,32}")
"""What can stand in streams; other names are left aside."""

SIDE_INFORMATION = "dvc3d.side_information"
SCENE_INTERPOLATORS = "dvc3d.scene_interpolators"
NOISE_MODELS = "dvc3d.noise_models"
PLANE_CODERS = "dvc3d.plane_coders"
INFERENCE = "dvc3d.inference"
DISPARITY_CODECS = "dvc3d.disparity_codecs"
"""Groups of entry points."""


@cache
def installed(group: str) -> "Mapping[str, EntryPoint]":
    """Return the entry points of a group by name, none of which is imported for it."""
    from importlib.metadata import entry_points

    found = sorted(entry_points(group=group), key=lambda entry: entry.name)
    return {entry.name: entry for entry in found if NAME.fullmatch(entry.name)}


def load(group: str, name: str) -> Any:
    """Import what is registered under a name."""
    entry = installed(group)[name]
    try:
        return entry.load()
    except Exception as err:  # an extension may raise anything
        package = entry.dist.name if entry.dist else entry.value
        raise ConfigError(f"extension {name!r} of {package} cannot be imported: {err}") from err


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
