"""A chapter of the thesis: steps that measure it, what it prints, and what its text leaves open."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

from dvc.web.drawing import Picture
from dvc.web.gallery import Table


class Way(StrEnum):
    """Whose method is measured."""

    THESIS = "thesis"
    """As the thesis writes it."""
    OURS = "ours"
    """As the commands of this project do it."""


BOTH = tuple(Way)


@dataclass(frozen=True)
class Task:
    """What is asked for."""

    folder: Path  # where results are kept
    data: Path | None = None  # folder of the real sets
    chosen: tuple[str, ...] = ()  # sets or sequences, or files of one's own; none: those of the preset
    full: bool = False  # hours rather than minutes
    jobs: int = 1  # processor cores that may be used
    frames: int | None = None  # of each sequence, in place of the preset's
    cluster: str | None = None  # address of a Dask scheduler that measures sequences
    disparities: str | None = None  # range of the disparities of own views

    @property
    def own(self) -> bool:
        """Whether files of one's own are to be measured."""
        return any(Path(name).is_file() for name in self.chosen)


class Value(NamedTuple):
    """A number, or what is said in its place."""

    place: str  # table or figure of the thesis, such as ``Table 2.1``
    what: str  # what it is of, with its unit
    value: float | str
    form: str = ".2f"

    @property
    def text(self) -> str:
        """As it is shown."""
        return self.value if isinstance(self.value, str) else format(self.value, self.form)


@dataclass
class Made:
    """What a step has measured and drawn."""

    values: list[Value] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)  # that show more than numbers of the thesis
    # by the number of their figure and what they are of; plots are contents of files by suffix
    pictures: dict[tuple[str, str], Picture] = field(default_factory=dict)
    plots: dict[tuple[str, str], dict[str, bytes]] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)  # what could not be measured; the step is made again


class Step(NamedTuple):
    """A part of a chapter, measured and kept by itself."""

    name: str  # for its file
    make: Callable[[Task, Way], Made]
    ways: tuple[Way, ...] = BOTH


class Figure(NamedTuple):
    """A figure or table of the thesis."""

    number: str  # such as ``2.9``
    shows: str
    instead: str = ""  # why it is not made here, or not from the same data, and what stands in its place


@dataclass(frozen=True)
class Chapter:
    """A chapter of the thesis."""

    number: int
    title: str
    # what the thesis prints, by place and by what it is of, in its order
    printed: Mapping[tuple[str, str], str]
    figures: Sequence[Figure]
    # what its text leaves open, and how it is read
    readings: Sequence[str]
    steps: Callable[[Task], Sequence[Step]]  # for a task
