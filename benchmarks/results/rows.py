"""The results of `rows.toml`: measurement, target, and canaries of their code."""

import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from benchmarks.results.code import ROOT
from benchmarks.results.harness import Measured, Setting

TABLE = Path(__file__).with_name("rows.toml")


@dataclass(frozen=True)
class Row:
    """One result."""

    name: str
    title: str  # description of the value
    measure: Callable[[Setting], Measured]
    form: str = "{:+.1f} %"  # format of the value
    at_most: float | None = None  # target
    at_least: float | None = None
    canaries: tuple[str, ...] = ("default",)  # configurations that it depends on
    files: tuple[Path, ...] = ()  # files that it is read from

    @property
    def target(self) -> str:
        """The target as text."""
        if self.at_most is not None:
            return f"≤ {self.written(self.at_most)}"
        return "no target" if self.at_least is None else f"≥ {self.written(self.at_least)}"

    def met(self, value: float) -> bool | None:
        """Return whether a value reaches the target, if there is one."""
        if self.at_most is not None:
            return value <= self.at_most
        return None if self.at_least is None else value >= self.at_least

    def written(self, value: float) -> str:
        """Write a value with its unit."""
        return self.form.format(value).replace("-", "−")

    @property
    def module(self) -> str:
        """Module that measures it."""
        function = self.measure.func if isinstance(self.measure, partial) else self.measure
        return function.__module__


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _row(measure: str, arguments: dict[str, Any] | None = None, **values: Any) -> Row:
    module, _, name = measure.partition(".")
    function = getattr(import_module(f"benchmarks.results.{module}"), name)
    if arguments:
        function = partial(function, **{name: _tuple(value) for name, value in arguments.items()})
    files = tuple(ROOT / path for path in values.pop("files", ()))
    return Row(measure=function, files=files, **{name: _tuple(value) for name, value in values.items()})


ROWS = tuple(_row(**row) for row in tomllib.loads(TABLE.read_text(encoding="utf-8"))["row"])
"""All results in the order of the page, apart from missed targets."""
BY_NAME = {row.name: row for row in ROWS}
