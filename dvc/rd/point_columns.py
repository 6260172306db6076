"""The columns of a table of points: rate, quality, shares of the bits, times."""

from collections.abc import Callable

from dvc.rd.curves import Curve
from dvc.rd.frames import bit_shares, num_of_types, type_ms
from dvc.rd.markdown import NOTHING
from dvc.rd.results import PointResult

Cell = Callable[[PointResult], str]


def points_cells(curve: Curve) -> tuple[list[str], list[list[str]]]:
    """Return what a table of the points of a curve says.

    Parameters
    ----------
    curve : Curve
        The curve.

    Returns
    -------
    head : list of str
        Titles of the columns that any point has something for.
    rows : list of list of str
        Cells of each point.
    """
    rows = [[cell(point) for cell in COLUMNS.values()] for point in curve.points]
    kept = [i for i in range(len(COLUMNS)) if any(row[i] != NOTHING for row in rows)]
    return [list(COLUMNS)[i] for i in kept], [[row[i] for i in kept] for row in rows]


def _total(name: str, form: str) -> Cell:
    def cell(point: PointResult) -> str:
        value = point.total(name)
        return NOTHING if value is None else form.format(value)

    return cell


def _share(*names: str) -> Cell:
    def cell(point: PointResult) -> str:
        shares = bit_shares(point)
        known = [shares[name] for name in names if name in shares]
        return f"{sum(known):.1f}" if known else NOTHING

    return cell


def _num_wyner_ziv(point: PointResult) -> int:
    return num_of_types(point, "wz")


def _per_wyner_ziv(name: str, form: str) -> Cell:
    def cell(point: PointResult) -> str:
        count, value = _num_wyner_ziv(point), point.total(name)
        return NOTHING if not count or value is None else form.format(value / count)

    return cell


def _preset(point: PointResult) -> str:
    preset = point.data["options"].get("wz_q")
    return NOTHING if preset is None else str(preset)


def _encode_ms(kind: str) -> Cell:
    def cell(point: PointResult) -> str:
        value = type_ms(point, kind)
        return NOTHING if value is None else f"{value:.1f}"

    return cell


COLUMNS: dict[str, Cell] = {
    "Q": _preset,
    "key QP": lambda point: "lossless" if point.data["key"].get("lossless") else str(point.data["key"]["qp"]),
    "rate [kbit/s]": _total("rate_kbps", "{:.1f}"),
    "PSNR [dB]": _total("psnr_y_db", "{:.2f}"),
    "key PSNR": _total("key_psnr_y_db", "{:.2f}"),
    "WZ PSNR": _total("wz_psnr_y_db", "{:.2f}"),
    "SI initial": _total("si_psnr_y_db", "{:.2f}"),
    "SI refined": _total("refined_si_psnr_y_db", "{:.2f}"),
    "key %": _share("key"),
    "intra %": _share("intra"),
    "inter %": _share("inter"),
    "parity %": _share("parity"),
    "CRC %": _share("crc"),
    "tracks %": _share("tracks"),
    "header %": _share("header"),
    "requests per WZ frame": _per_wyner_ziv("num_requests", "{:.0f}"),
    "decode s per WZ frame": _per_wyner_ziv("decode_s", "{:.2f}"),
    "encode CPU ms per key frame": _encode_ms("key"),
    "per WZ frame": _encode_ms("wz"),
}
"""Columns of the table of a curve, by title."""
