"""Tables over all sequences: side information, cost of encoding and decoding, shares of the bits."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dvc.rd.curves import ANCHOR_LABEL, Curve, Experiment
from dvc.rd.point_result import PointResult, mean, number
from dvc.rd.rate_cost import CAPTION, RateCost, rate_cost_cells
from dvc.rd.tables import NOTHING

SHARE_TITLES = {
    "key": "key frames",
    "intra": "intra frames",
    "inter": "inter frames",
    "parity": "parity",
    "crc": "check bits",
    "tracks": "tracks",
    "header": "headers",
    "stream": "not told apart",
}


@dataclass(frozen=True)
class Table:
    """A table whose first columns name its rows."""

    caption: str  # what it shows
    head: tuple[str, ...]  # titles
    rows: tuple[tuple[str, ...], ...]  # cells
    num_names: int = 1  # columns that name a row


def side_information_table(found: Sequence[Experiment]) -> Table | None:
    """Return the mean PSNR of the side information by sequence and codec."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for one in found:
        points = [(curve.label, point) for curve in one.curves for point in curve.points]
        points = [(label, point) for label, point in points if point.total("si_psnr_y_db") is not None]
        lossless = [(label, point) for label, point in points if point.data["key"].get("lossless")]
        for label, point in lossless or points:
            keys = "lossless" if lossless else point.level
            cells.setdefault((one.name, keys), {}).setdefault(label, _side_information(point))
    if not cells:
        return None
    labels = sorted({label for row in cells.values() for label in row})
    rows = [(*names, *(row.get(label, NOTHING) for label in labels)) for names, row in sorted(cells.items())]
    caption = (
        "Mean luma PSNR of the side information of Wyner-Ziv frames in dB, before decoding "
        "and, in brackets, as it was refined while decoding"
    )
    return Table(caption, ("sequence", "key frames", *labels), tuple(rows), 2)


def cost_table(found: Sequence[Experiment]) -> Table:
    """Return what encoding and decoding cost."""
    rows = []
    for one in found:
        anchor = one.anchor(ANCHOR_LABEL)
        intra = None if anchor is None else mean([point.coding_ms for point in anchor.points])
        for curve in one.curves:
            encode = mean([point.coding_ms for point in curve.points])
            ratio = None if encode is None or not intra else encode / intra
            numbers = [
                _format(mean([point.type_ms("key") for point in curve.points]), 2),
                _format(mean([point.type_ms("wz") for point in curve.points]), 2),
                _format(encode, 2),
                _format(ratio, 2),
                _format(mean([_process_ms(point, "encode") for point in curve.points]), 1),
                _format(mean([_process_ms(point, "decode") for point in curve.points]), 1),
            ]
            rows.append((one.name, curve.label, *numbers))
    times = ("key frame [ms]", "WZ frame [ms]", "any frame [ms]", f"any frame / {ANCHOR_LABEL}")
    head = ("sequence", "codec", *times, "encoder process [ms]", "decoder process [ms]")
    caption = (
        "CPU time per frame: encoding by type of frame, where it was measured apart; of any frame, tracking "
        "of points included, and its ratio to that of the intra anchor; whole processes, start-up included; "
        "means over the points of a curve"
    )
    return Table(caption, head, tuple(rows), 2)


def rate_cost_table(points: Sequence[RateCost], reference: str) -> Table:
    """Return rate against cost."""
    head, rows = rate_cost_cells(points, reference)
    return Table(CAPTION, tuple(head), tuple(map(tuple, rows)))


def shares(curve: Curve) -> list[dict[str, Any]]:
    """Return what the bits of each point of a curve are for."""
    rows = []
    for point in curve.points:
        parts = point.bit_shares
        text = ", ".join(f"{SHARE_TITLES.get(kind, kind)} {share:.1f} %" for kind, share in parts.items())
        rows.append({"name": point.label, "text": text, "parts": list(parts.items())})
    return rows


def chart_points(curve: Curve) -> list[dict[str, Any]]:
    """Return the points of a curve as charts need them."""
    return [
        {
            "name": point.label,
            "level": point.level if point.has_level else None,
            "lossless": point.data["key"].get("lossless") is True,
            "rate": round(point.rate_kbps, 3),
            "psnr": round(point.psnr_y_db, 3),
            "colour": None if point.psnr_yuv_db is None else round(point.psnr_yuv_db, 3),
            "frames": point.frame_columns,
        }
        for point in curve.points
    ]


def _side_information(point: PointResult) -> str:
    initial, refined = point.total("si_psnr_y_db"), point.total("refined_si_psnr_y_db")
    return f"{initial:.2f}" if refined is None else f"{initial:.2f} ({refined:.2f})"


def _process_ms(point: PointResult, process: str) -> float | None:
    total = number(point.data["times"][f"{process}_cpu_s"])
    return None if total is None else 1000 * total / max(1, point.data["totals"]["frames"])


def _format(value: float | None, decimals: int) -> str:
    return NOTHING if value is None else f"{value:.{decimals}f}"
