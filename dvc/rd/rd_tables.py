"""Tables, sentences and styles of curves that the page and the Markdown report share."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dvc import cli
from dvc.config import VARIANTS
from dvc.rd.anchors import ANCHOR_CODECS
from dvc.rd.comparison import NOTHING, RateCost, measure_titles
from dvc.rd.rd_curves import Curve, Experiment, table_measures
from dvc.rd.rd_results import IMPORTED, PointResult
from dvc.rd.specification import NO_FEEDBACK
from dvc.web.plotting import COLOURS, DASHES, MARKERS

RATE_COST_CAPTION = (
    "Mean difference in rate at equal PSNR, and processor time of encoding a frame without reading the input "
    "and loading code: means over the sequences that have both of a codec and of the reference; the lower "
    "left is best"
)
ANCHOR_COLOURS = ("#333333", "#B87F00", "#3D93CC", "#CC79A7", "#777777", "#009E73")
ANCHOR_MARKERS = ("x", "o", "s", "^", "D", "v")
ANCHOR_DASHES = ("dash", "dot", "dashdot", "longdash", "longdashdot", "dash")
Cell = Callable[[PointResult], str]


@dataclass(frozen=True)
class Style:
    """Style of a curve, the same in every plot of a report."""

    colour: str  # ``#rrggbb``
    marker: str  # marker of matplotlib
    dash: str  # dash of Plotly; a key of `MATPLOTLIB_DASHES`
    is_open: bool  # draw markers as outlines


def curve_styles(found: Sequence[Experiment]) -> dict[str, Style]:
    """Return the style of every label; curves with lossless key frames come last."""
    labels = {curve.label: curve.is_anchor for one in found for curve in one.curves}
    lossless = {curve.label for one in found for curve in one.curves if curve.has_lossless_keys}
    styles = {}
    for is_anchor, colours, markers, dashes, dashes_per_round in (
        (False, COLOURS, MARKERS, DASHES, 0),
        (True, ANCHOR_COLOURS, ANCHOR_MARKERS, ANCHOR_DASHES, 2),
    ):
        members = [label for label in labels if labels[label] == is_anchor]
        for number, label in enumerate(sorted(members, key=lambda one: (one in lossless, one))):
            round_, i = divmod(number, len(colours))
            dash = i + dashes_per_round * round_ if is_anchor else round_
            styles[label] = Style(
                colours[i], markers[(i + round_) % len(markers)], dashes[dash % len(dashes)], is_anchor
            )
    return styles


def rate_cost_cells(points: Sequence[RateCost], reference: str) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of the table of rate against cost."""
    in_colour = any(point.bd_rate_yuv_percent is not None for point in points)
    titles = measure_titles(table_measures(in_colour))
    head = ["codec", "encoder CPU a frame [ms]", *(f"BD-rate against {reference}{one}" for one in titles)]
    rows = []
    for point in points:
        rates = [point.bd_rate_percent, point.bd_rate_yuv_percent][: len(titles)]
        texts = [NOTHING if rate is None else f"{rate:+.1f} %" for rate in rates]
        rows.append([point.label, f"{point.cost_ms:.2f}", *texts, str(point.num_sequences)])
    return [*head, "sequences"], rows


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(map(escaped, line)) + " |\n" for line in lines)


def escaped(text: str) -> str:
    """Escape a text that may contain markup or the end of a cell or line."""
    return cli.one_line(text).replace("|", "\\|").replace("<", "&lt;")


def fenced(lines: Sequence[str]) -> str:
    """Return lines as a code block."""
    text = "".join(f"{line}\n" for line in lines)
    fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", text)), default=0))
    return f"{fence}\n{text}{fence}\n"


def preface(results: Sequence[PointResult]) -> str:
    """Return the origin of the points, and the meaning of rates and PSNRs."""
    return f"{measured_text(results)} {rates_text(results)} {psnrs_text(results)}"


def psnrs_text(results: Sequence[PointResult]) -> str:
    """Return the meaning of PSNRs."""
    if any(result.totals.psnr_yuv_db is not None for result in results):
        return "PSNRs are means of frames: of luma, and in colour (6 Y + Cb + Cr) / 8."
    return "PSNRs are of luma, means of frames."


def rates_text(results: Sequence[PointResult]) -> str:
    """Return the meaning of rates, and the number of proven ones."""
    codecs = [result for result in results if result.codec in VARIANTS]
    with_feedback = [result for result in codecs if result.options.options.get(NO_FEEDBACK) != "true"]
    sentences = []
    if with_feedback:
        proven = sum(result.is_proven for result in with_feedback)
        count = "each" if proven == len(with_feedback) else f"{proven} of {len(with_feedback)}"
        proof = f"a fresh process decoded {count} to the same frames" if proven else "none was decoded again"
        sentences.append(
            "Rates of distributed codecs are sizes of punctured streams, which hold only the bits that the "
            f"decoder requested; {proof}."
        )
    if len(with_feedback) < len(codecs):
        sentences.append("Rates of distributed codecs without feedback are sizes of the encoder's own files.")
    return " ".join([*sentences, f"Rates of {'other ' if codecs else ''}codecs are sizes of whole files."])


def measured_text(results: Sequence[PointResult]) -> str:
    """Return the number of points, their dates, and the versions of their code."""
    sources = [result.code.version for result in results if result.codec == IMPORTED]
    names = escaped(", ".join(sorted(set(sources))))
    imported = f"{len(sources)} points were not measured here: rates and PSNRs are those of {names}."
    results = [result for result in results if result.codec != IMPORTED]
    if not results:
        return imported
    versions = sorted({(result.code.version, result.code.commit or "no commit") for result in results})
    num_digests = len(code_digests(results))
    dates = sorted(result.date[:10] for result in results)
    code = escaped(", ".join(f"dvc3d {version} ({commit})" for version, commit in versions))
    mixed = f" The points come from {num_digests} versions of the code." if num_digests > 1 else ""
    period = dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
    text = f"{len(results)} points, measured {period} with {code}.{mixed}"
    return f"{text} {imported}" if sources else text


def code_digests(results: Sequence[PointResult]) -> set[str]:
    """Return the digests of the code that measured points of the project's codecs."""
    return {result.code.digest for result in results if result.codec not in {*ANCHOR_CODECS, IMPORTED}}


def points_cells(curve: Curve) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of the table of the points of a curve, without empty columns."""
    rows = [[cell(point) for cell in COLUMNS.values()] for point in curve.points]
    used = [i for i in range(len(COLUMNS)) if any(row[i] != NOTHING for row in rows)]
    return [list(COLUMNS)[i] for i in used], [[row[i] for i in used] for row in rows]


def number_text(value: float | None, decimals: int) -> str:
    """Write a number with a fixed number of decimals, or a dash."""
    return NOTHING if value is None else f"{value:.{decimals}f}"


def _total(name: str, decimals: int) -> Cell:
    return lambda point: number_text(getattr(point.totals, name), decimals)


def _share(kind: str) -> Cell:
    return lambda point: number_text(point.bit_shares.get(kind), 1)


def _per_wyner_ziv(name: str, decimals: int) -> Cell:
    def _cell(point: PointResult) -> str:
        count, value = point.num_frames("wz"), getattr(point.totals, name)
        return number_text(None if not count or value is None else value / count, decimals)

    return _cell


def _level(point: PointResult) -> str:
    return point.level if point.has_level else NOTHING


def _key_qp(point: PointResult) -> str:
    return "lossless" if point.key.lossless else number_text(point.key.qp, 0)


COLUMNS: dict[str, Cell] = {
    "level": _level,
    "key QP": _key_qp,
    "rate [kbit/s]": _total("rate_kbps", 1),
    "luma PSNR [dB]": _total("psnr_y_db", 2),
    "colour PSNR [dB]": _total("psnr_yuv_db", 2),
    "key PSNR": _total("key_psnr_y_db", 2),
    "WZ PSNR": _total("wz_psnr_y_db", 2),
    "SI initial": _total("si_psnr_y_db", 2),
    "SI refined": _total("refined_si_psnr_y_db", 2),
    "key %": _share("key"),
    "intra %": _share("intra"),
    "inter %": _share("inter"),
    "parity %": _share("parity"),
    "CRC %": _share("crc"),
    "tracks %": _share("tracks"),
    "header %": _share("header"),
    "requests per WZ frame": _per_wyner_ziv("num_requests", 0),
    "decode s per WZ frame": _per_wyner_ziv("decode_s", 2),
    "encode CPU ms per key frame": lambda point: number_text(point.cpu_ms("key_encode"), 1),
    "per WZ frame": lambda point: number_text(point.cpu_ms("wz_encode"), 1),
}
"""Columns of the table of a curve, by title."""
