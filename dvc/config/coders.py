"""Coders of bit planes that a decoder asks, each with settings of its own."""

from dataclasses import dataclass
from functools import cache
from typing import Any, Self

from dvc.config.fields import Section, check_choice, check_range
from dvc.extensions import PLANE_CODERS, Registry


@dataclass(frozen=True)
class CoderConfig(Section):
    """Settings of the coder of bit planes; results and streams also hold its name."""

    @property
    def name(self) -> str:
        """One of `CODERS`."""
        return next(name for name, coder in CODERS.items() if type(self) is coder)

    def to_dict(self) -> dict[str, Any]:
        """Return the name and the settings as JSON-safe values; inverse of `from_dict`."""
        return {"name": self.name, **super().to_dict()}

    @classmethod
    def build(cls, values: Any, name: str) -> Self:
        """Build the settings of the coder that is named, by default `DEFAULT_CODER`."""
        if cls is not CoderConfig or not isinstance(values, dict):
            return super().build(values, name)
        coder = values.get("name", DEFAULT_CODER)
        check_choice("coder", coder, CODERS)
        own = {key: value for key, value in values.items() if key != "name"}
        built = CODERS[coder].build(own, name)
        assert isinstance(built, cls)
        return built


@dataclass(frozen=True)
class CascadeConfig(CoderConfig):
    """Parities of ranges that the decoder chooses."""

    # Information of the answers to a request, in percent of the unknown bits of the run; 0: the least, which
    # costs the fewest bits. 12 and 6 save .3 and .5 % of the rate for 1.3 and 2.1 times the requests
    # (`benchmarks.searches.settings coder.batch_percent=6 --qp 28 36 --frames 33 --clips box desk tree stone
    # river street`).
    batch_percent: int = 20

    def _check_values(self) -> None:
        check_range("batch_percent", self.batch_percent, 0, 100)


@dataclass(frozen=True)
class TurboConfig(CoderConfig):
    """The classical pair of recursive convolutional codes, punctured; it has no settings."""


@cache
def _extension(name: str) -> type[CoderConfig]:
    """Return the settings of a coder that another package registers: none."""
    return type(name, (CoderConfig,), {"__reduce__": lambda self: (_build_extension, (name,))})


def _build_extension(name: str) -> CoderConfig:
    return _extension(name)()


CODERS: Registry[type[CoderConfig]] = Registry(
    PLANE_CODERS, {"cascade": CascadeConfig, "turbo": TurboConfig}, _extension
)
"""All coders by name."""
DEFAULT_CODER = "cascade"
