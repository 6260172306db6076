"""Results of points: one JSON file each, written whole or not at all; see `docs/results.md`."""

import json
import logging
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvc import cli
from dvc.errors import DvcError
from dvc.rd.anchors.codecs import ANCHOR_CODECS
from dvc.rd.anchors.version import anchors_digest
from dvc.rd.points import Point
from dvc.rd.provenance import CodeVersion, library_versions, values_digest
from dvc.rd.sources import Source

SCHEMA = "dvc3d-rd-point/2"
_FIRST_SCHEMA = "dvc3d-rd-point/1"
POINTS_FOLDER = "points"

MOST = 1e15
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
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Task:
    """A point with everything that identifies its result.

    Attributes
    ----------
    point : Point
        What to measure.
    source : Source
        On what.
    code : CodeVersion
        With which code.
    """

    point: Point
    source: Source
    code: CodeVersion

    @property
    def name(self) -> str:
        """Name of the result file without suffix: what a reader looks for, then what makes it unique."""
        point = self.point
        preset = "" if point.wz_q is None else f"-q{point.wz_q}"
        unique = values_digest([point.to_dict(), self.source.digest])[:8]
        return f"{self.source.name}-{point.codec}{preset}-qp{_plain(point.key_qp)}-{unique}"

    @property
    def identity(self) -> str:
        """Digest of configuration, input, code and libraries: equal if the result would be."""
        code = (self.code.version, self.code.digest)
        if self.point.codec in ANCHOR_CODECS:
            code = ("anchors", self.code_digest)
        made_by = [*code, library_versions()]
        return values_digest([SCHEMA, self.point.to_dict(), self.source.digest, made_by])

    @property
    def code_digest(self) -> str:
        """Digest of the code that makes the result: of the codec, or of what runs an anchor's encoder."""
        return anchors_digest() if self.point.codec in ANCHOR_CODECS else self.code.digest


@dataclass(frozen=True)
class PointResult:
    """A measured point.

    Attributes
    ----------
    name : str
        Of its file.
    data : dict
        Contents of the file, of which the required part has been checked.
    """

    name: str
    data: dict[str, Any]

    @property
    def rate_kbps(self) -> float:
        """Rate of the punctured stream in kbit/s."""
        return float(self.data["totals"]["rate_kbps"])

    @property
    def psnr_y_db(self) -> float:
        """Mean of the PSNRs of the frames in dB."""
        return float(self.data["totals"]["psnr_y_db"])

    def total(self, name: str) -> float | None:
        """Return a number of the totals.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        float or None
            None if there is none, as for Wyner-Ziv frames of an intra codec.
        """
        value = self.data["totals"].get(name)
        return float(value) if _is_number(value) else None


def read_result(path: Path) -> PointResult:
    """Read a result and check that it has what reports need.

    Parameters
    ----------
    path : Path
        File.

    Returns
    -------
    PointResult
        The result.

    Raises
    ------
    DvcError
        If the file is damaged, or of another schema.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        is_sound = _is_sound(data)
    except (ValueError, OSError, RecursionError) as err:
        raise DvcError(f"{path.name}: damaged result: {err}") from err
    if not isinstance(data, dict) or data.get("schema") not in (SCHEMA, _FIRST_SCHEMA):
        raise DvcError(f"{path.name}: not a result of schema {SCHEMA}")
    if not isinstance(data.get("identity"), str) or not isinstance(data.get("codec"), str):
        raise DvcError(f"{path.name}: damaged result: no identity or codec")
    if not is_sound:
        raise DvcError(f"{path.name}: damaged result: a number without bounds, or text that is none")
    for section, entries in _REQUIRED.items():
        values = data.get(section)
        for name, kind in entries.items():
            value = values.get(name) if isinstance(values, dict) else None
            if not isinstance(value, kind) or isinstance(value, bool) is not (kind is bool):
                raise DvcError(f"{path.name}: damaged result: {section}.{name} is missing or wrong")
    if data["totals"]["rate_kbps"] <= 0:
        raise DvcError(f"{path.name}: damaged result: no rate")
    for name, sound in _details(data).items():
        if not sound:
            raise DvcError(f"{path.name}: damaged result: {name} is wrong")
    return PointResult(path.stem, _upgraded(data) if data["schema"] == _FIRST_SCHEMA else data)


def write_result(folder: Path, name: str, data: dict[str, Any]) -> PointResult:
    """Write a result; the inverse of `read_result`.

    Parameters
    ----------
    folder : Path
        Of the experiment.
    name : str
        Of the result.
    data : dict
        JSON-safe values.

    Returns
    -------
    PointResult
        As `read_result` gives it.

    Raises
    ------
    DvcError
        If the file cannot be written.
    """
    path = folder / POINTS_FOLDER / f"{name}.json"
    cli.write_json(path, data)
    return read_result(path)


def finished(folder: Path, task: Task, any_version: bool = False) -> bool:
    """Tell whether a point has been measured already; say why an existing file does not count.

    Parameters
    ----------
    folder : Path
        Of the experiment.
    task : Task
        The point.
    any_version : bool, optional
        Accept what other versions of the code measured.

    Returns
    -------
    bool
        True if the result is there and is of this configuration, input and code.
    """
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
    """Read all results of an experiment; damaged ones are left out with a notice.

    Parameters
    ----------
    folder : Path
        Of the experiment.

    Returns
    -------
    list of PointResult
        Sorted by name.

    Raises
    ------
    DvcError
        If there is none.
    """
    results = []
    for path in sorted((folder / POINTS_FOLDER).glob("*.json")):
        try:
            results.append(read_result(path))
        except DvcError as err:
            _LOG.warning("%s; left out", err)
    if not results:
        raise DvcError(f"{folder}: no results in its folder {POINTS_FOLDER}; make some with `dvc-rd run`")
    return results


def _upgraded(data: dict[str, Any]) -> dict[str, Any]:
    """Return a sound result of the first schema as one of today's.

    The first did not know the time of tracking, and its early results count loading of code as time of
    Wyner-Ziv frames: these are left out.
    """
    times = dict(data["times"])
    if "encode_start_up_cpu_s" not in times:
        times.pop("wz_encode_cpu_s", None)
    return {**data, "schema": SCHEMA, "times": times}


def _details(data: dict[str, Any]) -> dict[str, bool]:
    """Tell of every entry that has parts, or may be missing, whether it is as it should be."""
    bits, options, frames = data["totals"]["bits"], data["options"], data.get("per_frame", [])
    counts = list(bits.values())
    return {
        "totals.bits": all(type(count) is int and count >= 0 for count in counts) and sum(counts) > 0,
        "options.options": all(isinstance(value, str) for value in options["options"].values()),
        "options.wz_q": options.get("wz_q") is None or type(options["wz_q"]) is int,
        "times": all(_is_number(value) for value in data["times"].values()),
        "sequence": min(data["sequence"]["width"], data["sequence"]["height"]) > 0,
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
    return not isinstance(value, (int, float)) or -MOST < value < MOST


def _is_list_of_text(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(item, str) for item in value)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _plain(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "_", text)[:20]
