"""Rows of the H.264 reference software, measured elsewhere, as points beside ours."""

import csv
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from dvc.errors import DvcError
from dvc.rd.point_result import PointResult
from dvc.rd.points import SCHEMA
from dvc.rd.results import MAX_NUMBER

ROWS_VARIABLE: Final = "DVC_ANCHORS"
"""Environment variable with the name of a file of rows."""
REFERENCE_LABELS: Final = {
    "jm95-intra": "JM 9.5 intra",
    "jm95-ippp-zero": "JM 9.5 IPPP, zero motion",
    "jm95-ippp-search": "JM 9.5 IPPP",
}
"""Labels of the reference software's codecs, by their names in the file."""
_ENTROPY, _CHROMA = "cabac", "none"


@dataclass(frozen=True)
class ReferenceRow:
    """One point of the reference software."""

    clip: str  # name of the sequence; its frames from 0 on
    codec: str  # one of `REFERENCE_LABELS`
    qp: int  # for I and P pictures
    frames: int  # number of frames
    num_bits: int  # of the whole file
    psnr_y_db: float  # mean luma PSNR


def read_reference_rows(path: Path) -> list[ReferenceRow]:
    """Read the rows that code luma alone, with CABAC."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as err:
        raise DvcError(f"{path}: cannot be read: {getattr(err, 'strerror', None) or err}") from err
    try:
        return [
            _row(row)
            for row in csv.DictReader(line for line in lines if not line.startswith("#"))
            if row["codec"] in REFERENCE_LABELS and (row["entropy"], row["chroma"]) == (_ENTROPY, _CHROMA)
        ]
    except (csv.Error, KeyError, TypeError, ValueError) as err:
        raise DvcError(f"{path}: not a table of reference points: {err}") from err


def reference_results(results: Sequence[PointResult], path: Path | None = None) -> list[PointResult]:
    """Return the points of the reference software on frames that were measured."""
    if path is None and not os.environ.get(ROWS_VARIABLE):
        return []
    rows = read_reference_rows(path or Path(os.environ[ROWS_VARIABLE]))
    measured = {}
    for result in results:
        sequence, options, frames = (
            result.data["sequence"],
            result.data["options"],
            result.data["totals"]["frames"],
        )
        if options["start"] == 0 and options["luma_only"]:
            measured[sequence["digest"], frames] = sequence
    return [
        _result(row, sequence)
        for (_, frames), sequence in measured.items()
        for row in rows
        if (row.clip, row.frames) == (sequence["name"], frames)
    ]


def _row(row: dict[str, str]) -> ReferenceRow:
    read = ReferenceRow(
        row["clip"],
        row["codec"],
        int(row["qp"]),
        int(row["frames"]),
        int(row["bits_total"]),
        float(row["psnr_y"]),
    )
    if not (read.frames >= 1 and 1 <= read.num_bits < MAX_NUMBER and abs(read.psnr_y_db) < MAX_NUMBER):
        raise ValueError(f"{read.frames} frames, {read.num_bits} bits, {read.psnr_y_db} dB")
    return read


def _result(row: ReferenceRow, sequence: dict[str, Any]) -> PointResult:
    duration_s = row.frames / sequence["frames_per_s"]
    data = {
        "schema": SCHEMA,
        "identity": "",
        "sequence": sequence,
        "codec": row.codec,
        "options": {
            "codec": row.codec,
            "wz_q": None,
            "key_qp": str(row.qp),
            "gop": 1 if row.codec == "jm95-intra" else 0,
            "start": 0,
            "frames": row.frames,
            "luma_only": True,
            "options": {},
        },
        "code": {"version": "JM 9.5", "commit": None, "digest": ""},
        "key": {"qp": row.qp, "lossless": False},
        "totals": {
            "frames": row.frames,
            "duration_s": duration_s,
            "stream_bytes": row.num_bits // 8,
            "rate_kbps": row.num_bits / duration_s / 1000,
            "psnr_y_db": row.psnr_y_db,
            "bits": {"stream": row.num_bits},
        },
        "times": {"encode_cpu_s": None, "decode_cpu_s": None},
    }
    return PointResult(f"{row.clip}-{row.codec}-qp{row.qp}", data)
