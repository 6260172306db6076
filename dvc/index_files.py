"""Index files of folders: JSON that names pictures and maps, read strictly."""

import json
import math
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from dvc.array_files import MAX_LABELS, MAX_NUMBER, MIN_STEP, is_unicode
from dvc.arrays import Floats
from dvc.errors import DvcError
from dvc.files import read_whole
from dvc.geometry.camera_array import DisparityLabels

MAX_SIDE = 1 << 15
"""Longest side of pictures in index files."""


class Entry:
    """An object of an index file; missing values and wrong types are errors of one line."""

    def __init__(self, path: Path, values: object, name: str = "") -> None:
        self.path, self.name = path, name
        if not isinstance(values, dict):
            self.refuse("expected an object")
        self._values = values

    def refuse(self, reason: str) -> NoReturn:
        """Raise an error that names the file and the object."""
        raise DvcError(f"{self.path}: {self.name + ': ' if self.name else ''}{reason}")

    def without(self, *keys: str) -> dict[str, Any]:
        """Return all values except some."""
        return {key: value for key, value in self._values.items() if key not in keys}

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def value(self, key: str) -> Any:
        """Return a value of any kind."""
        if key not in self._values:
            self.refuse(f"no {key!r}")
        return self._values[key]

    def integer(self, key: str, low: int, high: int) -> int:
        """Return a whole number in a range."""
        value = self.value(key)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            self.refuse(f"{key!r} must be a whole number from {low} to {high}")
        return value

    def shape(self) -> tuple[int, int]:
        """Return the height and width of a picture."""
        return self.integer("height", 1, MAX_SIDE), self.integer("width", 1, MAX_SIDE)

    def number(self, key: str, above: float = -math.inf) -> float:
        """Return a finite number."""
        return self._number(self.value(key), key, above)

    def _number(
        self, value: object, key: str, above: float = -math.inf, largest: float = MAX_NUMBER
    ) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse(f"{key!r} must be a number")
        if not abs(value) <= largest or not value > above:
            self.refuse(f"{key!r} is out of range")
        return float(value)

    def text(self, key: str) -> str:
        """Return text."""
        value = self.value(key)
        if not isinstance(value, str):
            self.refuse(f"{key!r} must be text")
        if not is_unicode(value):
            self.refuse(f"{key!r} must be Unicode text")
        return value

    def entry(self, key: str) -> "Entry":
        """Return an object."""
        return Entry(self.path, self.value(key), key)

    def entries(self, key: str, most: int) -> list["Entry"]:
        """Return a list of objects."""
        values = self.value(key)
        if not isinstance(values, list) or not 1 <= len(values) <= most:
            self.refuse(f"{key!r} must be a list of 1 to {most}")
        return [Entry(self.path, value, f"{key} {index}") for index, value in enumerate(values)]

    def vector(self, key: str, size: int, largest: float = MAX_NUMBER) -> Floats:
        """Return a list of finite numbers."""
        values = self.value(key)
        if not isinstance(values, list) or len(values) != size:
            self.refuse(f"{key!r} must be a list of {size} numbers")
        return np.array([self._number(value, key, largest=largest) for value in values], np.float64)

    def matrix(self, key: str, size: int) -> Floats:
        """Return a square matrix that can be inverted."""
        rows = self.value(key)
        if not isinstance(rows, list) or any(not isinstance(row, list) or len(row) != size for row in rows):
            self.refuse(f"{key!r} must be a {size}x{size} matrix")
        matrix = np.array([[self._number(value, key) for value in row] for row in rows], np.float64)
        if matrix.shape != (size, size) or not np.linalg.cond(matrix) < 1e15:
            self.refuse(f"{key!r} must be an invertible {size}x{size} matrix")
        return matrix

    def file(self, key: str) -> Path:
        """Return a file of the folder."""
        name = self.text(key)
        if Path(name).name != name or not name.isprintable() or not name:
            self.refuse(f"{name!r} does not name a file in the folder")
        return self.path.parent / name


def write_index(path: Path, format_name: str, version: int, values: dict[str, Any]) -> None:
    """Write an index file; inverse of `read_index`."""
    index = {"format": format_name, "version": version, **values}
    path.write_text(json.dumps(index, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_index(path: Path, format_name: str, version: int, writer: str) -> Entry:
    """Read an index file."""
    try:
        values = json.loads(read_whole(path).decode(), parse_float=_finite, parse_constant=_finite)
    except (FileNotFoundError, NotADirectoryError) as err:
        raise DvcError(f"{path.parent}: not a folder of `{writer}`") from err
    except (ValueError, RecursionError) as err:
        raise DvcError(f"{path}: not a JSON file") from err
    if not isinstance(values, dict) or values.get("format") != format_name:
        raise DvcError(f"{path}: not an index of `{writer}`")
    if values.get("version") != version:
        raise DvcError(f"{path}: version {values.get('version')!r} is not supported, only {version}")
    return Entry(path, values)


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text} is not finite")
    return number


def read_labels(entry: Entry) -> DisparityLabels:
    """Read the tried disparities of an index file."""
    step, num_labels = entry.number("step", 0.0), entry.integer("num_labels", 1, MAX_LABELS)
    if step < MIN_STEP * (1.0 - 1e-6):  # rounded to single precision
        entry.refuse("'step' is out of range")
    return DisparityLabels(entry.number("lowest"), step, num_labels)
