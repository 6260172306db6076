"""Tables of results, and what stands above them: Markdown, the columns of points, what was measured when."""

import csv
import io
import re
from collections.abc import Callable, Iterable, Sequence

from dvc import cli
from dvc.config import VARIANTS
from dvc.rd.anchors.codecs import ANCHOR_CODECS
from dvc.rd.curves import Curve
from dvc.rd.point_result import IMPORTED, PointResult
from dvc.rd.points import NO_FEEDBACK
from dvc.rd.reference_rows import REFERENCE_LABELS

Cell = Callable[[PointResult], str]
NOTHING = "–"
"""What a cell without a value shows."""


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(map(escaped, line)) + " |\n" for line in lines)


def escaped(text: str) -> str:
    """Write a text so that it is neither markup nor the end of a cell or line."""
    return cli.one_line(text).replace("|", "\\|").replace("<", "&lt;")


def fenced(lines: Sequence[str]) -> str:
    """Write lines as a block that is shown as it is."""
    text = "".join(f"{line}\n" for line in lines)
    fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", text)), default=0))
    return f"{fence}\n{text}{fence}\n"


def csv_text(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as comma-separated values."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    for row in rows:
        writer.writerow([str(cell).lower() if isinstance(cell, bool) else cell for cell in row])
    return text.getvalue()


def preface(results: Sequence[PointResult]) -> str:
    """Say what a report rests on."""
    return f"{measured_text(results)} {rates_text(results)} {psnrs_text(results)}\n"


def psnrs_text(results: Sequence[PointResult]) -> str:
    """Say what PSNRs are of."""
    if any(result.psnr_yuv_db is not None for result in results):
        return "PSNRs are means of frames: of luma, and in colour (6 Y + Cb + Cr) / 8."
    return "PSNRs are of luma, means of frames."


def rates_text(results: Sequence[PointResult]) -> str:
    """Say what rates are sizes of, and how many of them were proven."""
    own = [result for result in results if result.data["codec"] in VARIANTS]
    asked = [result for result in own if result.data["options"]["options"].get(NO_FEEDBACK) != "true"]
    told = []
    if asked:
        proven = sum(result.is_proven for result in asked)
        count = "each" if proven == len(asked) else f"{proven} of {len(asked)}"
        proof = f"a fresh process decoded {count} to the same frames" if proven else "none was decoded again"
        told.append(
            "Rates of distributed codecs are sizes of punctured streams, which hold what the decoder asked "
            f"for and nothing else; {proof}."
        )
    if len(asked) < len(own):
        told.append("Rates of distributed codecs without feedback are sizes of the encoder's own files.")
    return " ".join([*told, f"Rates of {'other ' if own else ''}codecs are sizes of whole files."])


def measured_text(results: Sequence[PointResult]) -> str:
    """Say what was measured, when, and by which code."""
    others = [r.data["code"]["version"] for r in results if r.data["codec"] == IMPORTED]
    sources = escaped(", ".join(sorted({*others})))
    imported = f"{len(others)} points were not measured here: rates and PSNRs are those of {sources}."
    results = [r for r in results if r.data["codec"] not in (*REFERENCE_LABELS, IMPORTED)]
    if not results:
        return imported
    codes = sorted(
        {(r.data["code"]["version"], r.data["code"].get("commit") or "no commit") for r in results}
    )
    digests = code_digests(results)
    dates = sorted(str(r.data.get("date", ""))[:10] for r in results)
    code = escaped(", ".join(f"dvc3d {version} ({commit})" for version, commit in codes))
    mixed = f" The points come from {len(digests)} versions of the code." if len(digests) > 1 else ""
    period = dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
    told = f"{len(results)} points, measured {period} with {code}.{mixed}"
    return f"{told} {imported}" if others else told


def code_digests(results: Sequence[PointResult]) -> set[str]:
    """Return the versions of the code that made points of the project's own codecs."""
    others = {*ANCHOR_CODECS, *REFERENCE_LABELS, IMPORTED}
    return {result.data["code"]["digest"] for result in results if result.data["codec"] not in others}


def points_cells(curve: Curve) -> tuple[list[str], list[list[str]]]:
    """Return what a table of the points of a curve says."""
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
        shares = point.bit_shares
        known = [shares[name] for name in names if name in shares]
        return f"{sum(known):.1f}" if known else NOTHING

    return cell


def _num_wyner_ziv(point: PointResult) -> int:
    return point.num_frames("wz")


def _per_wyner_ziv(name: str, form: str) -> Cell:
    def cell(point: PointResult) -> str:
        count, value = _num_wyner_ziv(point), point.total(name)
        return NOTHING if not count or value is None else form.format(value / count)

    return cell


def _level(point: PointResult) -> str:
    return point.level if point.has_level else NOTHING


def _key_qp(point: PointResult) -> str:
    key = point.data["key"]
    return "lossless" if key.get("lossless") else NOTHING if key["qp"] is None else str(key["qp"])


def _encode_ms(kind: str) -> Cell:
    def cell(point: PointResult) -> str:
        value = point.type_ms(kind)
        return NOTHING if value is None else f"{value:.1f}"

    return cell


COLUMNS: dict[str, Cell] = {
    "level": _level,
    "key QP": _key_qp,
    "rate [kbit/s]": _total("rate_kbps", "{:.1f}"),
    "luma PSNR [dB]": _total("psnr_y_db", "{:.2f}"),
    "colour PSNR [dB]": _total("psnr_yuv_db", "{:.2f}"),
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
