"""Points that others have measured, read from comma-separated values and kept as results beside ours."""

import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from dvc.errors import DvcError
from dvc.rd.point_result import IMPORTED, PointResult
from dvc.rd.points import SCHEMA
from dvc.rd.provenance import values_digest
from dvc.rd.results import MAX_NUMBER, POINTS_FOLDER, read_results, write_result

OPENDVC: Final = "opendvc"
"""Name of the points of openDVC, which come with this package."""
MAX_CHARACTERS: Final = 2**24
"""Of a file."""
TOTALS: Final = (
    *("key_psnr_y_db", "wz_psnr_y_db", "si_psnr_y_db", "refined_si_psnr_y_db"),
    *("psnr_cb_db", "psnr_cr_db", "psnr_yuv_db"),
)
"""Columns that become totals of the same name, where they hold a number."""
_REQUIRED: Final = ("sequence", "codec", "rate_kbps", "psnr_y_db", "frames")
_TRUTHS: Final = {"": False, "true": True, "false": False}
_MAX_PX, _MAX_DB = 2**16, 1000.0


class _Key(NamedTuple):
    """What curves must have in common to be compared, but for the digest of the sequence."""

    sequence: str
    first_frame: int
    frames: int
    luma_only: bool


def import_points(path: Path, folder: Path) -> list[PointResult]:
    """Read points and write them as results; they replace those of the same codecs and sequences."""
    text, name = _text(path)
    there = _results(folder)
    measured = {_key(result): result.data["sequence"] for result in there if result.data["codec"] != IMPORTED}
    points: dict[str, dict[str, Any]] = {}
    for number, row in _rows(text, name):
        try:
            data = _point(row, name, measured)
        except ValueError as err:
            raise DvcError(f"{name}: line {number}: {err}") from err
        stem = _stem(data)
        if stem in points:
            raise DvcError(f"{name}: line {number}: the same point a second time: give it a name in 'point'")
        points[stem] = data
    if not points:
        raise DvcError(f"{name}: no points")
    _make_folder(folder / POINTS_FOLDER)
    written = [write_result(folder, stem, data) for stem, data in points.items()]
    curves = {_curve(result) for result in written}
    for result in there:
        if result.data["codec"] == IMPORTED and _curve(result) in curves and result.name not in points:
            (folder / POINTS_FOLDER / f"{result.name}.json").unlink()
    return written


def beside_nothing(points: Sequence[PointResult], folder: Path) -> list[str]:
    """Return the sequences of imported points on whose frames nothing was measured here."""
    own = {_key(result) for result in read_results(folder) if result.data["codec"] != IMPORTED}
    return list(dict.fromkeys(_key(point).sequence for point in points if _key(point) not in own))


def _results(folder: Path) -> list[PointResult]:
    return read_results(folder) if any((folder / POINTS_FOLDER).glob("*.json")) else []


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise DvcError(f"cannot write to {folder}: {err.strerror}") from err


def _text(path: Path) -> tuple[str, str]:
    """Return a file and its name."""
    is_ours = str(path) == OPENDVC and not path.exists()
    path = Path(__file__).with_name(f"{OPENDVC}.csv") if is_ours else path
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            text = file.read(MAX_CHARACTERS + 1)
    except (OSError, UnicodeDecodeError) as err:
        raise DvcError(f"{path}: cannot be read: {getattr(err, 'strerror', None) or err}") from err
    if len(text) > MAX_CHARACTERS:
        raise DvcError(f"{path}: more than {MAX_CHARACTERS} characters")
    return text, path.name


def _rows(text: str, name: str) -> list[tuple[int, Mapping[str, str]]]:
    """Return the rows with the numbers of their lines; lines that begin with # are left out."""
    kept = "".join("\n" if line.startswith("#") else line for line in io.StringIO(text, newline=""))
    reader = csv.reader(io.StringIO(kept, newline=""), strict=True)
    try:
        lines = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(row)]
    except csv.Error as err:
        raise DvcError(f"{name}: line {reader.line_num}: {err}") from err
    head = lines[0][1] if lines else []
    if missing := [column for column in _REQUIRED if column not in head]:
        raise DvcError(
            f"{name}: no column {', '.join(missing)}; the first line must name {', '.join(_REQUIRED)}"
        )
    for number, row in lines[1:]:
        if len(row) != len(head):
            raise DvcError(f"{name}: line {number}: {len(row)} cells under {len(head)} columns")
    return [(number, dict(zip(head, row, strict=True))) for number, row in lines[1:]]


def _point(row: Mapping[str, str], source: str, measured: Mapping[_Key, Any]) -> dict[str, Any]:
    """Return the contents of a result."""
    for name in ("sequence", "codec"):
        if not row[name]:
            raise ValueError(f"{name} is empty")
        if not row[name].isprintable():
            raise ValueError(f"{name} has characters that cannot be shown")
    totals = {"rate_kbps": _number(row, "rate_kbps", MAX_NUMBER / 1e6)}
    names = ["psnr_y_db", *(name for name in TOTALS if row.get(name))]
    totals |= {name: _number(row, name, _MAX_DB) for name in names}
    luma_only = row.get("luma_only", "").lower()
    if luma_only not in _TRUTHS:
        raise ValueError(f"luma_only must be true or false, got {luma_only!r}")
    first, frames = _whole(row, "first_frame", 0, 0), _whole(row, "frames", 1)
    key = _Key(row["sequence"], first, frames, _TRUTHS[luma_only])
    sequence = measured.get(key) or _sequence(row, key)
    qp = _whole(row, "qp", -100) if row.get("qp") else None
    told = {
        "curve": row.get("curve") or row["codec"],
        "point": row.get("point") or f"{totals['rate_kbps']:g} kbit/s",
    }
    return {
        "identity": values_digest(dict(row)),
        "code": {"version": row.get("source") or source, "commit": None, "digest": ""},
        **_result(key, sequence, qp, told, totals),
    }


def _result(
    key: _Key, sequence: dict[str, Any], qp: int | None, told: dict[str, str], totals: dict[str, float]
) -> dict[str, Any]:
    duration_s = key.frames / sequence["frames_per_s"]
    bits = 1000 * totals["rate_kbps"] * duration_s
    if not max(bits, duration_s) < MAX_NUMBER:
        raise ValueError(f"{key.frames} frames, {sequence['frames_per_s']:g} a second, last too long")
    num_bits = max(8, round(bits))
    return {
        "schema": SCHEMA,
        "sequence": sequence,
        "codec": IMPORTED,
        "options": {
            "codec": IMPORTED,
            "wz_q": None,
            "key_qp": "" if qp is None else str(qp),
            "gop": 0,
            "start": key.first_frame,
            "frames": key.frames,
            "luma_only": key.luma_only,
            "options": told,
        },
        "key": {"qp": qp, "lossless": False},
        "totals": {
            "frames": key.frames,
            "duration_s": duration_s,
            "stream_bytes": num_bits // 8,
            **totals,
            "bits": {"stream": num_bits},
        },
        "times": {"encode_cpu_s": None, "decode_cpu_s": None},
    }


def _sequence(row: Mapping[str, str], key: _Key) -> dict[str, Any]:
    """Return what a row says of a sequence that was not measured here."""
    if missing := [name for name in ("width", "height", "frames_per_s") if not row.get(name)]:
        where = f"frames {key.first_frame} to {key.first_frame + key.frames - 1} of {key.sequence}"
        raise ValueError(f"{', '.join(missing)} must be given, as nothing is measured here on {where}")
    size = {name: _whole(row, name, 1, most=_MAX_PX) for name in ("width", "height")}
    digest = row.get("sequence_digest") or values_digest([IMPORTED, row["sequence"]])
    frames_per_s = _number(row, "frames_per_s", 1e6)
    return {"name": row["sequence"], "digest": digest, **size, "frames_per_s": frames_per_s}


def _number(row: Mapping[str, str], name: str, most: float) -> float:
    """Return a number above 0."""
    text = row.get(name, "")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value <= most:
        raise ValueError(f"{name} must be a number above 0, got {text!r}")
    return value


def _whole(
    row: Mapping[str, str], name: str, least: int, default: int | None = None, *, most: int = 10**9
) -> int:
    text = row.get(name, "")
    if not text and default is not None:
        return default
    if not re.fullmatch(r"-?[0-9]{1,9}", text) or not least <= int(text) <= most:
        raise ValueError(f"{name} must be a whole number from {least} on, got {text!r}")
    return int(text)


def _key(result: PointResult) -> _Key:
    options, totals = result.data["options"], result.data["totals"]
    name = result.data["sequence"]["name"]
    return _Key(name, options["start"], totals["frames"], options["luma_only"])


def _curve(result: PointResult) -> tuple[_Key, str]:
    return _key(result), str(result.data["options"]["options"]["curve"])


def _stem(data: Mapping[str, Any]) -> str:
    """Return the name of the file: what a reader looks for, then what makes it unique."""
    options = data["options"]
    unique = values_digest([data["sequence"]["name"], options])[:8]
    words = [data["sequence"]["name"], options["options"]["curve"], unique]
    return "-".join(re.sub(r"[^A-Za-z0-9_.]+", "_", word)[:60] for word in words)
