"""Numbers of a point for charts: its frames and its bits, whatever a file has or lacks."""

import math
from collections.abc import Sequence
from typing import Any

from dvc.config import VARIANTS
from dvc.rd.results import PointResult

SHARES = ("key", "intra", "inter", "parity", "crc", "tracks", "header", "stream")
"""What bits can be, in the order in which shares are shown."""
LETTERS = {"key": "k", "intra": "k", "wz": "w", "inter": "p"}
DECIMALS = {"psnr": 2, "initial": 2, "refined": 2, "requests": 0, "decode": 3, "kbits": 3}


def number(value: object) -> float | None:
    """Return a number, or nothing for what is none.

    Parameters
    ----------
    value : object
        Part of a result.

    Returns
    -------
    float or None
        Finite.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return float(value)


def mean(values: Sequence[float | None]) -> float | None:
    """Return the mean of the numbers there are.

    Parameters
    ----------
    values : sequence of float or None
        Any.

    Returns
    -------
    float or None
        None if there is none.
    """
    there = [value for value in values if value is not None]
    return sum(there) / len(there) if there else None


def frame_rows(point: PointResult) -> list[dict[str, Any]]:
    """Return the frames of a point.

    Parameters
    ----------
    point : PointResult
        The point.

    Returns
    -------
    list of dict
        As the result has them; empty if it has none.
    """
    rows = point.data.get("per_frame")
    return [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []


def num_of_types(point: PointResult, *types: str) -> int:
    """Count frames.

    Parameters
    ----------
    point : PointResult
        The point.
    *types : str
        Types of frames.

    Returns
    -------
    int
        How many are of one of these.
    """
    return sum(row.get("type") in types for row in frame_rows(point))


def encoding_times_s(point: PointResult) -> list[float] | None:
    """Return the processor times of encoding that belong to frames: the loading of code is left out.

    Parameters
    ----------
    point : PointResult
        The point.

    Returns
    -------
    list of float or None
        In seconds: of key frames, Wyner-Ziv frames and tracking, or of an anchor's encoder; None if one of
        these was not measured.
    """
    times = point.data["times"]
    if "coding_cpu_s" in times:
        names = ["coding_cpu_s"]
    else:
        names = ["key_encode_cpu_s"]
        names += ["wz_encode_cpu_s"] if num_of_types(point, "wz") else []
        codec = point.data["codec"]
        tracks = codec in VARIANTS and VARIANTS[codec].tracks.kind != "none"
        names += ["tracking_cpu_s"] if tracks else []
    parts = [number(times.get(name)) for name in names]
    known = [part for part in parts if part is not None]
    return known if len(known) == len(parts) else None


def type_ms(point: PointResult, kind: str) -> float | None:
    """Return the processor time of encoding a frame of one type.

    Parameters
    ----------
    point : PointResult
        The point.
    kind : str
        ``key`` or ``wz``.

    Returns
    -------
    float or None
        Mean in milliseconds; None if it was not measured, or there is no such frame.
    """
    total, count = number(point.data["times"].get(f"{kind}_encode_cpu_s")), num_of_types(point, kind)
    return None if total is None or not count else 1000 * total / count


def frame_columns(point: PointResult) -> dict[str, Any]:
    """Return what charts show of the frames of a point.

    Parameters
    ----------
    point : PointResult
        The point.

    Returns
    -------
    dict
        ``types``, a letter per frame; ``psnr``, ``initial`` and ``refined`` in dB, ``kbits``, ``requests``,
        ``decode`` in seconds: lists with None where there is no number; columns without any are left out.
    """
    rows = frame_rows(point)
    columns: dict[str, list[float | None]] = {
        "psnr": [number(row.get("psnr_y_db")) for row in rows],
        "initial": [number(row.get("si_psnr_y_db")) for row in rows],
        "refined": [number(row.get("refined_si_psnr_y_db")) for row in rows],
        "kbits": [_kbits(row.get("bits")) for row in rows],
        "requests": [number(row.get("num_requests")) for row in rows],
        "decode": [number(row.get("decode_s")) for row in rows],
    }
    kept: dict[str, Any] = {
        name: [None if value is None else round(value, DECIMALS[name]) for value in values]
        for name, values in columns.items()
        if any(value is not None for value in values)
    }
    first = number(rows[0].get("index")) if rows else None
    kept["first"] = int(point.data["options"]["start"] + (first or 0))
    kept["types"] = "".join(LETTERS.get(str(row.get("type")), "?") for row in rows)
    return kept


def bit_shares(point: PointResult) -> dict[str, float]:
    """Return what the bits of a point are for.

    Parameters
    ----------
    point : PointResult
        The point.

    Returns
    -------
    dict of str to float
        Per cent of all, by kind; kinds without a bit are left out.
    """
    bits = {str(name): number(value) or 0.0 for name, value in point.data["totals"]["bits"].items()}
    total = sum(bits.values())
    if total <= 0:
        return {}
    order = [*SHARES, *sorted(set(bits) - set(SHARES))]
    return {name: 100 * bits[name] / total for name in order if bits.get(name, 0.0) > 0}


def _kbits(bits: object) -> float | None:
    if isinstance(bits, dict):
        parts = [number(value) for value in bits.values()]
        return sum(part for part in parts if part is not None) / 1000
    whole = number(bits)
    return None if whole is None else whole / 1000
