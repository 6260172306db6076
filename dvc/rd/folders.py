"""Results of several folders, put together for one report."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dvc.rd.provenance import values_digest
from dvc.rd.results import POINTS_FOLDER, PointResult, read_results

PICTURE_KINDS = ("original", "decoded", "predicted", "key")


@dataclass(frozen=True)
class Collection:
    """What a report is made from.

    Attributes
    ----------
    results : tuple of PointResult
        Each point once; the files of their pictures are absolute.
    notes : tuple of str
        What a reader must know: files that were left out, results that newer ones replace.
    """

    results: tuple[PointResult, ...]
    notes: tuple[str, ...]


def read_folders(folders: Sequence[Path]) -> Collection:
    """Read the results of several experiments.

    Parameters
    ----------
    folders : sequence of Path
        What ``dvc-rd run --out`` was given.

    Returns
    -------
    Collection
        Of points that were measured several times, the newest.

    Raises
    ------
    DvcError
        If a folder has no results.
    """
    newest: dict[str, PointResult] = {}
    damaged: list[str] = []
    num_replaced = 0
    for folder in folders:
        found = read_results(folder)
        kept = {result.name for result in found}
        damaged += [
            path.name for path in sorted((folder / POINTS_FOLDER).glob("*.json")) if path.stem not in kept
        ]
        for result in found:
            key = values_digest([result.data["codec"], result.data["options"], result.data["sequence"]])
            other = newest.get(key)
            num_replaced += other is not None and other.data["identity"] != result.data["identity"]
            if other is None or str(result.data.get("date", "")) > str(other.data.get("date", "")):
                newest[key] = replace(result, data=_located(result.data, folder))
    notes = []
    if damaged:
        notes.append(f"{_count(len(damaged), 'damaged file')} left out: {', '.join(damaged)}.")
    if num_replaced:
        notes.append(f"{_count(num_replaced, 'result')} of an older measurement left out for a newer one.")
    return Collection(tuple(newest.values()), tuple(notes))


def _located(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Make the names of pictures absolute; one that leads out of the folder is dropped."""
    pictures = data.get("pictures")
    if not isinstance(pictures, dict):
        return data
    root = folder.resolve()
    numbers = {name: pictures.get(name) for name in ("index", "key_index")}
    located: dict[str, Any] = {name: n if type(n) is int else None for name, n in numbers.items()}
    for kind in PICTURE_KINDS:
        name = pictures.get(kind)
        path = (root / name).resolve() if isinstance(name, str) and "\0" not in name else root
        located[kind] = str(path) if root in path.parents else None
    return {**data, "pictures": located}


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
