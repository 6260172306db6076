"""Points as comma-separated values: export of results, import of points that were measured elsewhere."""

import csv
import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec
from msgspec import Meta

from dvc.errors import DvcError
from dvc.rd.originals import values_digest
from dvc.rd.rd_curves import experiments
from dvc.rd.rd_results import (
    IMPORTED,
    MAX_NUMBER,
    POINTS_FOLDER,
    PointResult,
    read_results,
    write_result,
)
from dvc.rd.specification import SCHEMA

OPENDVC: Final = "opendvc"
"""Name of the points of openDVC, which are part of this package."""
MAX_CHARACTERS: Final = 2**24
"""Largest size of a file."""
_MAX_PX, _MAX_DB = 2**16, 1000.0
_REQUIRED: Final = ("sequence", "codec", "rate_kbps", "psnr_y_db", "frames")
_SIZE = ("width", "height", "frames_per_s")

Column = Callable[[PointResult], object]


def _columns(section: str, names: str, prefix: str = "") -> dict[str, Column]:
    """Return columns that are fields of a section of results."""
    return {prefix + name: attrgetter(f"{section}.{name}") for name in names.split()}


def _bits(kind: str) -> Column:
    return lambda point: point.totals.bits.get(kind)


def _options(point: PointResult) -> str:
    """Write further options of the encoder as `--option` takes them."""
    options = sorted(point.options.options.items())
    return " ".join(name if value == "true" else f"{name}={value}" for name, value in options)


POINT_COLUMNS: dict[str, Column] = {
    "point": attrgetter("name"),
    "codec": attrgetter("codec"),
    **_columns("options", "gop wz_q"),
    "key_qp": attrgetter("key.qp"),
    "lossless_keys": attrgetter("key.lossless"),
    "side_information": attrgetter("options.side_information"),
    "options": _options,
    **_columns("sequence", "width height frames_per_s"),
    "first_frame": attrgetter("options.start"),
    "frames": attrgetter("totals.frames"),
    "luma_only": attrgetter("options.luma_only"),
    **_columns("totals", "rate_kbps psnr_y_db key_psnr_y_db wz_psnr_y_db si_psnr_y_db refined_si_psnr_y_db"),
    "stream_bytes": attrgetter("totals.stream_bytes"),
    **{f"{kind}_bits": _bits(kind) for kind in ("key", "tracks", "parity", "crc", "header")},
    **_columns("totals", "num_requests num_failed_planes"),
    **_columns("times", "encode_cpu_s decode_cpu_s"),
    **_columns("code", "version commit digest", "code_"),
    "sequence_digest": attrgetter("sequence.digest"),
    "date": attrgetter("date"),
    **{f"{kind}_bits": _bits(kind) for kind in ("intra", "inter")},
    **_columns("times", "key_encode_cpu_s wz_encode_cpu_s tracking_cpu_s coding_cpu_s"),
    "qp": attrgetter("options.qp"),
    **_columns("totals", "psnr_cb_db psnr_cr_db psnr_yuv_db"),
}
"""Columns of `results_csv` after `sequence` and `curve`; new ones are added at the end only."""

_POINT_OF_FRAME = ("point", "codec", "gop", "wz_q", "key_qp", "lossless_keys")
FRAME_COLUMNS = (
    *("index", "type", "bits", "psnr_y_db", "si_psnr_y_db", "refined_si_psnr_y_db", "num_requests"),
    *("num_failed_planes", "side_information", "side_information_reason", "decode_s", "key_bits"),
    *("tracks_bits", "parity_bits", "crc_bits", "header_bits", "psnr_cb_db", "psnr_cr_db"),
)
"""Columns of a frame, after those of its point; new ones are added at the end only."""


def results_csv(results: Sequence[PointResult], *, per_frame: bool = False) -> str:
    """Write a line for each point, or for each frame of each point."""
    names = _POINT_OF_FRAME if per_frame else tuple(POINT_COLUMNS)
    rows: list[list[object]] = []
    for one in experiments(results):
        for curve in one.curves:
            for point in curve.points:
                cells = [point.sequence.name, curve.label, *(POINT_COLUMNS[name](point) for name in names)]
                for frame in point.per_frame if per_frame else ():
                    values = asdict(frame)
                    if isinstance(frame.bits, dict):  # by kind
                        values["bits"] = sum(frame.bits.values())
                        values |= {f"{kind}_bits": count for kind, count in frame.bits.items()}
                    rows.append([*cells, *(values.get(name) for name in FRAME_COLUMNS)])
                if not per_frame:
                    rows.append(cells)
    return csv_text(("sequence", "curve", *names, *(FRAME_COLUMNS if per_frame else ())), rows)


def csv_text(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as comma-separated values."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    for row in rows:
        writer.writerow([str(cell).lower() if isinstance(cell, bool) else cell for cell in row])
    return text.getvalue()


Text = Annotated[str, Meta(min_length=1)]
Decibels = Annotated[float, Meta(gt=0, le=_MAX_DB)]
Pixels = Annotated[int, Meta(ge=1, le=_MAX_PX)]


class ImportedRow(msgspec.Struct, kw_only=True):
    """Cells of a row that is imported; empty ones are absent."""

    sequence: Text
    codec: Text
    rate_kbps: Annotated[float, Meta(gt=0, le=MAX_NUMBER / 1e6)]
    psnr_y_db: Decibels
    frames: Annotated[int, Meta(ge=1, le=10**9)]
    first_frame: Annotated[int, Meta(ge=0, le=10**9)] = 0
    luma_only: bool = False
    qp: Annotated[int, Meta(ge=-100, le=10**9)] | None = None
    width: Pixels | None = None
    height: Pixels | None = None
    frames_per_s: Annotated[float, Meta(gt=0, le=1e6)] | None = None
    key_psnr_y_db: Decibels | None = None
    wz_psnr_y_db: Decibels | None = None
    si_psnr_y_db: Decibels | None = None
    refined_si_psnr_y_db: Decibels | None = None
    psnr_cb_db: Decibels | None = None
    psnr_cr_db: Decibels | None = None
    psnr_yuv_db: Decibels | None = None
    sequence_digest: str = ""
    curve: str = ""
    point: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        if not (self.sequence + self.codec).isprintable():
            raise ValueError("sequence or codec has characters that cannot be shown")


Frames = tuple[str, int, int, bool]
"""Sequence, first frame, number of frames, luma only: curves with the same ones can be compared."""


def _frames(result: PointResult) -> Frames:
    options = result.options
    return result.sequence.name, options.start, result.totals.frames, options.luma_only


def _curve(result: PointResult) -> tuple[Frames, str]:
    return _frames(result), result.options.options["curve"]


def import_points(path: Path, folder: Path) -> list[PointResult]:
    """Read points and write them as results, which replace those of the same codecs and sequences."""
    if str(path) == OPENDVC and not path.exists():
        path = Path(__file__).with_name(f"{OPENDVC}.csv")
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            text = file.read(MAX_CHARACTERS + 1)
    except (OSError, UnicodeDecodeError) as err:
        raise DvcError(f"{path}: cannot be read: {getattr(err, 'strerror', None) or err}") from err
    if len(text) > MAX_CHARACTERS:
        raise DvcError(f"{path}: more than {MAX_CHARACTERS} characters")
    name = path.name
    has_results = any((folder / POINTS_FOLDER).glob("*.json"))
    previous = read_results(folder) if has_results else []
    measured = {_frames(result): asdict(result.sequence) for result in previous if result.codec != IMPORTED}
    points: dict[str, dict[str, Any]] = {}
    for number, row in _rows(text, name):
        try:
            data = _point(row, name, measured)
        except ValueError as err:
            problem = str(err).replace("$.", "")
            raise DvcError(f"{name}: line {number}: {problem}") from err
        words = [data["sequence"]["name"], data["options"]["options"]["curve"]]
        words.append(values_digest([data["sequence"]["name"], data["options"]])[:8])
        stem = "-".join(re.sub(r"[^A-Za-z0-9_.]+", "_", word)[:60] for word in words)
        if stem in points:
            raise DvcError(f"{name}: line {number}: the same point a second time: give it a name in 'point'")
        points[stem] = data
    if not points:
        raise DvcError(f"{name}: no points")
    try:
        (folder / POINTS_FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise DvcError(f"cannot write to {folder}: {err.strerror}") from err
    written = [write_result(folder, stem, data) for stem, data in points.items()]
    curves = {_curve(result) for result in written}
    for result in previous:
        if result.codec == IMPORTED and _curve(result) in curves and result.name not in points:
            (folder / POINTS_FOLDER / f"{result.name}.json").unlink()
    return written


def unmatched_sequences(points: Sequence[PointResult], folder: Path) -> list[str]:
    """Return the sequences of imported points without a measured point on the same frames."""
    measured = {_frames(result) for result in read_results(folder) if result.codec != IMPORTED}
    return list(dict.fromkeys(point.sequence.name for point in points if _frames(point) not in measured))


def _rows(text: str, name: str) -> list[tuple[int, Mapping[str, str]]]:
    """Return the rows with the numbers of their lines, without lines that begin with #."""
    lines = "".join("\n" if line.startswith("#") else line for line in io.StringIO(text, newline=""))
    reader = csv.reader(io.StringIO(lines, newline=""), strict=True)
    try:
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(row)]
    except csv.Error as err:
        raise DvcError(f"{name}: line {reader.line_num}: {err}") from err
    head = rows[0][1] if rows else []
    if missing := [column for column in _REQUIRED if column not in head]:
        raise DvcError(
            f"{name}: no column {', '.join(missing)}; the first line must name {', '.join(_REQUIRED)}"
        )
    for number, row in rows[1:]:
        if len(row) != len(head):
            raise DvcError(f"{name}: line {number}: {len(row)} cells under {len(head)} columns")
    return [(number, dict(zip(head, row, strict=True))) for number, row in rows[1:]]


def _point(cells: Mapping[str, str], source: str, measured: Mapping[Frames, Any]) -> dict[str, Any]:
    given = {name: value.lower() if name == "luma_only" else value for name, value in cells.items() if value}
    row = msgspec.convert(given, ImportedRow, strict=False)
    frames = (row.sequence, row.first_frame, row.frames, row.luma_only)
    sequence = measured.get(frames)
    if sequence is None:
        if missing := [name for name in _SIZE if getattr(row, name) is None]:
            span = f"frames {row.first_frame} to {row.first_frame + row.frames - 1} of {row.sequence}"
            raise ValueError(f"{', '.join(missing)} must be given, as nothing is measured here on {span}")
        digest = row.sequence_digest or values_digest([IMPORTED, row.sequence])
        size = {name: getattr(row, name) for name in _SIZE}
        sequence = {"name": row.sequence, "digest": digest, **size}
    duration_s = row.frames / sequence["frames_per_s"]
    bits = 1000 * row.rate_kbps * duration_s
    if not max(bits, duration_s) < MAX_NUMBER:
        raise ValueError(f"{row.frames} frames, {sequence['frames_per_s']:g} a second, last too long")
    num_bits = max(8, round(bits))
    psnrs = {name: value for name, value in msgspec.structs.asdict(row).items() if name.endswith("_db")}
    return {
        "schema": SCHEMA,
        "identity": values_digest(dict(cells)),
        "code": {"version": row.source or source, "commit": None, "digest": ""},
        "sequence": sequence,
        "codec": IMPORTED,
        "options": {
            "codec": IMPORTED,
            "wz_q": None,
            "key_qp": "" if row.qp is None else str(row.qp),
            "gop": 0,
            "start": row.first_frame,
            "frames": row.frames,
            "luma_only": row.luma_only,
            "options": {
                "curve": row.curve or row.codec,
                "point": row.point or f"{row.rate_kbps:g} kbit/s",
            },
        },
        "key": {"qp": row.qp, "lossless": False},
        "totals": {
            "frames": row.frames,
            "duration_s": duration_s,
            "stream_bytes": num_bits // 8,
            "rate_kbps": row.rate_kbps,
            **{name: value for name, value in psnrs.items() if value is not None},
            "bits": {"stream": num_bits},
        },
        "times": {"encode_cpu_s": None, "decode_cpu_s": None},
    }
