"""What was tried in parts: how much, with which code, and what was found."""

import json
import os
import secrets
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from benchmarks.results.code import ROOT, code_digest
from dvc import cli
from dvc.errors import DvcError

FUZZING, CUTS = ROOT / "docs" / "fuzzing.json", ROOT / "docs" / "cuts.json"
SCHEMA = "dvc3d-tried/1"
FIRST = 10**9
"""Numbers of inputs are drawn from here on; those below are for tries that are made again."""


@dataclass
class Part:
    """What was tried with one code."""

    code: str
    date: str  # of its last input
    bounds: bool  # whether kernels checked bounds
    seconds: dict[str, float] = field(default_factory=dict)  # by kind, of one process
    inputs: dict[str, int] = field(default_factory=dict)  # by kind
    finds: dict[str, str] = field(default_factory=dict)  # outcome by kind and number
    unsteady: dict[str, str] = field(default_factory=dict)  # what was not found a second time


@dataclass
class Tried:
    """All parts; written in one piece after each addition, so that a kill loses what was not yet added."""

    path: Path
    next_number: int
    parts: list[Part]

    @classmethod
    def read(cls, path: Path) -> "Tried":
        """Go on with a file, or begin one."""
        if not path.exists():
            return cls(path, FIRST + secrets.randbelow(FIRST), [])
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            if data["schema"] != SCHEMA:
                raise DvcError(f"{path}: not of schema {SCHEMA}")
            return cls(path, data["next_number"], [Part(**part) for part in data["parts"]])
        except (ValueError, KeyError, TypeError) as err:
            raise DvcError(f"{path}: not what was written there: {err}") from err

    def add(
        self,
        kind: str,
        inputs: int,
        seconds: float,
        finds: Mapping[str, str],
        unsteady: Mapping[str, str],
    ) -> None:
        """Add inputs of a kind, with what the code is now."""
        code, bounds = code_digest(), os.environ.get("NUMBA_BOUNDSCHECK") == "1"
        if not self.parts or (self.parts[-1].code, self.parts[-1].bounds) != (code, bounds):
            self.parts.append(Part(code, "", bounds))
        part = self.parts[-1]
        part.date = datetime.now(UTC).date().isoformat()
        part.inputs[kind] = part.inputs.get(kind, 0) + inputs
        part.seconds[kind] = round(part.seconds.get(kind, 0.0) + seconds, 1)
        part.finds |= finds
        part.unsteady |= unsteady
        parts = [asdict(each) for each in self.parts]
        cli.write_json(self.path, {"schema": SCHEMA, "next_number": self.next_number, "parts": parts})

    def take(self, count: int) -> range:
        """Return numbers that nobody has had."""
        self.next_number += count
        return range(self.next_number - count, self.next_number)

    @property
    def inputs(self) -> Counter[str]:
        """Inputs by kind, of all parts."""
        return sum((Counter(part.inputs) for part in self.parts), Counter[str]())

    def seconds(self, kind: str) -> float:
        """Return what a kind has taken so far."""
        return sum(part.seconds.get(kind, 0.0) for part in self.parts)

    @property
    def finds(self) -> dict[str, str]:
        """All finds."""
        return {name: outcome for part in self.parts for name, outcome in part.finds.items()}

    @property
    def hours(self) -> float:
        """What all parts took."""
        return sum(sum(part.seconds.values()) for part in self.parts) / 3600.0

    def told(self) -> str:
        """Say with which code how much was tried."""
        return ", ".join(
            f"{sum(part.inputs.values())} with code {part.code}"
            + ("" if part.bounds else " without bounds checks")
            for part in self.parts
        )
