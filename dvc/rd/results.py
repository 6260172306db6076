"""Results of points: one JSON file each, written whole or not at all; see `docs/results.md`."""

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dvc import cli
from dvc.errors import DvcError
from dvc.rd.point_result import IMPORTED, PointResult
from dvc.rd.points import SCHEMA, Task
from dvc.rd.provenance import values_digest

POINTS_FOLDER = "points"
PICTURE_KINDS = ("original", "decoded", "predicted", "key")

MAX_NUMBER = 1e15
"""Numbers of results are below."""
_NUMBER = (int, float)
_REQUIRED: dict[str, dict[str, type | tuple[type, ...]]] = {
    "sequence": {"name": str, "digest": str, "width": int, "height": int, "frames_per_s": _NUMBER},
    "code": {"version": str, "digest": str},
    "options": {"gop": int, "start": int, "luma_only": bool, "key_qp": str, "options": dict},
    "totals": {"frames": int, "stream_bytes": int, "rate_kbps": _NUMBER, "psnr_y_db": _NUMBER, "bits": dict},
    "key": {"qp": int},
    "times": {"encode_cpu_s": _NUMBER, "decode_cpu_s": _NUMBER},
}
_UNKNOWN = {"qp", "encode_cpu_s", "decode_cpu_s"}
"""What imported points may lack."""
_LOG = logging.getLogger(__name__)


def read_result(path: Path) -> PointResult:
    """Read a result and check that it has what reports need."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        is_sound = _is_sound(data)
    except (ValueError, OSError, RecursionError) as err:
        raise DvcError(f"{path.name}: damaged result: {err}") from err
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise DvcError(f"{path.name}: not a result of schema {SCHEMA}")
    if not isinstance(data.get("identity"), str) or not isinstance(data.get("codec"), str):
        raise DvcError(f"{path.name}: damaged result: no identity or codec")
    if not is_sound:
        raise DvcError(f"{path.name}: damaged result: a number without bounds, or text that is none")
    for section, entries in _REQUIRED.items():
        values = data.get(section)
        for name, kind in entries.items():
            value = values.get(name) if isinstance(values, dict) else None
            if value is None and name in _UNKNOWN and data["codec"] == IMPORTED and isinstance(values, dict):
                continue
            if not isinstance(value, kind) or isinstance(value, bool) is not (kind is bool):
                raise DvcError(f"{path.name}: damaged result: {section}.{name} is missing or wrong")
    if data["totals"]["rate_kbps"] <= 0:
        raise DvcError(f"{path.name}: damaged result: no rate")
    for name, sound in _details(data).items():
        if not sound:
            raise DvcError(f"{path.name}: damaged result: {name} is wrong")
    return PointResult(path.stem, data)


def write_result(folder: Path, name: str, data: dict[str, Any]) -> PointResult:
    """Write a result; the inverse of `read_result`."""
    path = folder / POINTS_FOLDER / f"{name}.json"
    cli.write_json(path, data)
    return read_result(path)


def finished(folder: Path, task: Task, any_version: bool = False) -> bool:
    """Tell whether a point has been measured already; say why an existing file does not count."""
    path = folder / POINTS_FOLDER / f"{task.name}.json"
    if not path.exists():
        return False
    try:
        found = read_result(path).data
    except DvcError as err:
        _LOG.warning("%s; measuring again", err)
        return False
    if found["identity"] == task.identity or (any_version and found["options"] == task.point.to_dict()):
        return True
    _LOG.warning("%s: made by another version of the code; measuring again", path.name)
    return False


def read_results(folder: Path) -> list[PointResult]:
    """Read all results of an experiment; damaged ones are left out with a notice."""
    results = []
    for path in sorted((folder / POINTS_FOLDER).glob("*.json")):
        try:
            results.append(read_result(path))
        except DvcError as err:
            _LOG.warning("%s; left out", err)
    if not results:
        raise DvcError(f"{folder}: no results in its folder {POINTS_FOLDER}; make some with `dvc-rd run`")
    return results


@dataclass(frozen=True)
class Collection:
    """What a report is made from."""

    results: tuple[PointResult, ...]  # each point once; the files of their pictures are absolute
    # what a reader must know: files that were left out, results that newer ones replace
    notes: tuple[str, ...]


def read_folders(folders: Sequence[Path]) -> Collection:
    """Read the results of several experiments."""
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


def _details(data: dict[str, Any]) -> dict[str, bool]:
    """Tell of every entry that has parts, or may be missing, whether it is as it should be."""
    bits, options, frames = data["totals"]["bits"], data["options"], data.get("per_frame", [])
    counts = list(bits.values())
    return {
        "totals.bits": all(type(count) is int and count >= 0 for count in counts) and sum(counts) > 0,
        "options.options": _is_table_of_text(options["options"])
        and (data["codec"] != IMPORTED or {"curve", "point"} <= options["options"].keys()),
        "options.decoder": _is_table_of_text(options.get("decoder", {})),
        "options.wz_q": options.get("wz_q") is None or type(options["wz_q"]) is int,
        "options.qp": options.get("qp") is None or type(options["qp"]) is int,
        "times": all(_is_number(value) or value is None for value in data["times"].values()),
        "code.commit": isinstance(data["code"].get("commit"), str | None),
        "sequence": min(data["sequence"][name] for name in ("width", "height", "frames_per_s")) > 0,
        "per_frame": isinstance(frames, list)
        and all(isinstance(frame, dict) and isinstance(frame.get("type"), str) for frame in frames)
        and all(type(frame.get("index", 0)) is int for frame in frames),
        "commands": _is_list_of_text(data.get("commands", [])),
        "pictures": data.get("pictures") is None or isinstance(data["pictures"], dict),
    }


def _is_sound(value: object) -> bool:
    """Tell whether all numbers in a JSON value are finite and can be written, and all text as well."""
    if isinstance(value, dict):
        return all(_is_sound(part) for pair in value.items() for part in pair)
    if isinstance(value, list):
        return all(_is_sound(part) for part in value)
    if isinstance(value, str):
        return not any("\ud800" <= letter <= "\udfff" for letter in value)
    return not isinstance(value, (int, float)) or -MAX_NUMBER < value < MAX_NUMBER


def _is_list_of_text(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(item, str) for item in value)


def _is_table_of_text(value: object) -> bool:
    return isinstance(value, dict) and all(isinstance(item, str) for item in value.values())


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


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
