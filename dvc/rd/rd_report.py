"""The report of an experiment as Markdown with plots; tables, sentences and styles that the page shares."""

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvc import cli
from dvc.config import VARIANTS
from dvc.errors import DvcError
from dvc.files import atomic_output
from dvc.rd.anchors import ANCHOR_CODECS
from dvc.rd.comparison import NOTHING, RateCost, Verdict, bd_rate_text, measure_titles, rate_costs, verdicts
from dvc.rd.rd_curves import (
    ANCHOR_LABEL,
    Comparison,
    Curve,
    Experiment,
    compare_curves,
    experiments,
    table_measures,
)
from dvc.rd.rd_results import IMPORTED, PointResult
from dvc.rd.specification import NO_FEEDBACK
from dvc.web.plotting import (
    COLOURS,
    DASHES,
    MARKERS,
    MATPLOTLIB_DASHES,
    SIZE_INCHES,
    SUFFIXES,
    contents,
    new_figure,
    plain,
)

RATE_COST_CAPTION = (
    "Mean difference in rate at equal PSNR, and processor time of encoding a frame without reading the input "
    "and loading code: means over the sequences that have both of a codec and of the reference; the lower "
    "left is best"
)
RATE_COST_SLUG = "rate-against-cost"
LABEL_ROOM_PX = 14
ANCHOR_COLOURS = ("#333333", "#B87F00", "#3D93CC", "#CC79A7", "#777777", "#009E73")
ANCHOR_MARKERS = ("x", "o", "s", "^", "D", "v")
ANCHOR_DASHES = ("dash", "dot", "dashdot", "longdash", "longdashdot", "dash")


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


def preface(results: Sequence[PointResult]) -> str:
    """Return number, dates and versions of the points, and the meaning of rates and PSNRs."""
    sources = [result.code.version for result in results if result.codec == IMPORTED]
    names = escaped(", ".join(sorted(set(sources))))
    imported = f"{len(sources)} points were not measured here: rates and PSNRs are those of {names}."
    measured = [result for result in results if result.codec != IMPORTED]
    sentences = [imported] if sources or not measured else []
    if measured:
        versions = sorted({(result.code.version, result.code.commit or "no commit") for result in measured})
        num_digests = len(code_digests(measured))
        dates = sorted(result.date[:10] for result in measured)
        code = escaped(", ".join(f"dvc3d {version} ({commit})" for version, commit in versions))
        mixed = f" The points come from {num_digests} versions of the code." if num_digests > 1 else ""
        period = dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
        sentences.insert(0, f"{len(measured)} points, measured {period} with {code}.{mixed}")
    return " ".join([*sentences, rates_text(results), psnrs_text(results)])


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


def _total(name: str, decimals: int) -> Callable[[PointResult], str]:
    return lambda point: number_text(getattr(point.totals, name), decimals)


def _share(kind: str) -> Callable[[PointResult], str]:
    return lambda point: number_text(point.bit_shares.get(kind), 1)


def _per_wyner_ziv(point: PointResult, name: str, decimals: int) -> str:
    count, value = point.num_frames("wz"), getattr(point.totals, name)
    return number_text(None if not count or value is None else value / count, decimals)


COLUMNS: dict[str, Callable[[PointResult], str]] = {
    "level": lambda point: point.level if point.has_level else NOTHING,
    "key QP": lambda point: "lossless" if point.key.lossless else number_text(point.key.qp, 0),
    "rate [kbit/s]": _total("rate_kbps", 1),
    "luma PSNR [dB]": _total("psnr_y_db", 2),
    "colour PSNR [dB]": _total("psnr_yuv_db", 2),
    "key PSNR": _total("key_psnr_y_db", 2),
    "WZ PSNR": _total("wz_psnr_y_db", 2),
    "SI initial": _total("si_psnr_y_db", 2),
    "SI refined": _total("refined_si_psnr_y_db", 2),
    **{f"{kind} %": _share(kind) for kind in ("key", "intra", "inter", "parity")},
    "CRC %": _share("crc"),
    **{f"{kind} %": _share(kind) for kind in ("tracks", "header")},
    "requests per WZ frame": lambda point: _per_wyner_ziv(point, "num_requests", 0),
    "decode s per WZ frame": lambda point: _per_wyner_ziv(point, "decode_s", 2),
    "encode CPU ms per key frame": lambda point: number_text(point.cpu_ms("key_encode"), 1),
    "per WZ frame": lambda point: number_text(point.cpu_ms("wz_encode"), 1),
}
"""Columns of the table of a curve, by title."""


def write_report(
    results: Sequence[PointResult],
    outputs: Sequence[Path],
    anchor: str = ANCHOR_LABEL,
    *,
    folder: Path,
    judged: Sequence[Verdict] | None = None,
    stem: str = "report",
) -> list[Path]:
    """Write the plots into a folder, and the report as Markdown files that show them; return the plots."""
    found = experiments(results)
    styles, costs = curve_styles(found), rate_costs(found, anchor)
    rendered = {one.slug: render_experiment(one, styles, anchor) for one in found}
    if len(costs) > 1:
        rendered[RATE_COST_SLUG] = render_rate_cost(costs, styles, anchor)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise DvcError(f"cannot write to {folder}: {err.strerror}") from err
    written: dict[str, list[Path]] = {}
    for slug, files in rendered.items():
        for suffix, data in files.items():
            path = folder / f"{stem}-{slug}{suffix}"
            with atomic_output(path) as temporary:
                temporary.write_bytes(data)
            written.setdefault(slug, []).append(path)
    judged = verdicts(found) if judged is None else judged
    for path in outputs:
        names = {slug: os.path.relpath(paths[0], path.parent) for slug, paths in written.items()}
        with atomic_output(path) as temporary:
            temporary.write_text(_report_text(found, results, names, judged, anchor), encoding="utf-8")
    return [file for paths in written.values() for file in paths]


def _report_text(
    found: Sequence[Experiment],
    results: Sequence[PointResult],
    pictures: dict[str, str],
    judged: Sequence[Verdict],
    anchor: str,
) -> str:
    """Return the report as Markdown; `pictures` are file names by slug."""
    measures = table_measures(any(experiment.in_colour for experiment in found))
    rows = []
    for experiment in found:
        reference = experiment.anchor(anchor)
        for curve in experiment.curves:
            if curve.label == anchor or curve.has_lossless_keys or (curve.is_anchor and reference is None):
                continue
            texts = [NOTHING] * len(measures)
            if reference is not None:
                rates = (compare_curves(reference, curve, "rate", measure) for measure in measures)
                texts = [bd_rate_text(rate) for rate in rates]
            rows.append([experiment.name, curve.label, *texts])
    titles = [f"BD-rate against {anchor}{one} (overlap, points)" for one in measure_titles(measures)]
    parts = [
        f"# Rate-distortion report\n\n{preface(results)}\n\n## BD-rate\n",
        "Mean difference in rate at equal PSNR (PCHIP on the logarithm of the rate); negative is better.\n",
        table(["sequence", "codec", *titles], rows),
    ]
    if judged:
        parts += [
            "## Every curve against every other\n",
            "BD-rates; a mean is followed by the number of sequences with a figure for both curves.\n",
        ]
    for verdict in judged:
        matrix = [[name, *(cell.text for cell in cells)] for name, cells in verdict.matrix]
        parts += [
            f"<details><summary>Against {escaped(verdict.anchor)}</summary>\n",
            table(["sequence", *verdict.columns], matrix),
            "</details>\n",
        ]
    if RATE_COST_SLUG in pictures:
        parts += [
            f"## Rate against cost of encoding\n\n{RATE_COST_CAPTION}.\n",
            f"![BD-rate over the processor time of the encoder]({pictures[RATE_COST_SLUG]})\n",
            table(*rate_cost_cells(rate_costs(found, anchor), anchor)),
        ]
    for experiment in found:
        name = escaped(experiment.name)
        parts.append(f"## {name}\n\n{escaped(experiment.title)}.\n")
        parts.append(f"![Rate-distortion curves of {name}]({pictures[experiment.slug]})\n")
        for curve in experiment.curves:
            parts += [f"### {name}, {escaped(curve.label)}\n", table(*points_cells(curve))]
        commands = [line for curve in experiment.curves for point in curve.points for line in point.commands]
        text = "".join(f"{line}\n" for line in commands)
        fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", text)), default=0))
        parts += ["<details><summary>Commands</summary>\n", f"{fence}\n{text}{fence}\n", "</details>\n"]
    return "\n".join(parts)


def render_experiment(experiment: Experiment, styles: Mapping[str, Style], anchor: str) -> dict[str, bytes]:
    """Draw the curves of an experiment; return the files by suffix."""
    reference = experiment.anchor(anchor)
    curves = [curve for curve in experiment.curves if not curve.has_lossless_keys] or experiment.curves
    codecs = [curve for curve in curves if not curve.is_anchor]
    with new_figure(SIZE_INCHES) as figure:
        axes = figure.add_subplot()
        for curve in curves:
            style = styles[curve.label]
            dash = MATPLOTLIB_DASHES[style.dash]
            options = _line_options(style, _legend(curve, reference))
            axes.plot(curve.rates_kbps, curve.psnrs_y_db, linestyle=dash, **options)
        if any(len(curve.points) > 1 for curve in codecs):  # anchors may leave the range of the codecs
            rates = [rate for curve in codecs for rate in curve.rates_kbps]
            psnrs = [psnr for curve in codecs for psnr in curve.psnrs_y_db]
            width, height = max(rates) - min(rates), max(max(psnrs) - min(psnrs), 1.0)
            axes.set_xlim(max(0.0, min(rates) - 0.2 * width), max(rates) + 0.3 * max(width, 0.1 * max(rates)))
            axes.set_ylim(min(psnrs) - 0.15 * height, max(psnrs) + 0.12 * height)
        if codecs:
            # The levels next to the points of a curve, if they have room.
            last = (float("-inf"), float("-inf"))
            for point in codecs[0].points:
                x, y = axes.transData.transform((point.rate_kbps, point.psnr_y_db))
                if max(abs(x - last[0]), abs(y - last[1])) < LABEL_ROOM_PX:
                    continue
                last = (x, y)
                axes.annotate(
                    point.level,
                    (point.rate_kbps, point.psnr_y_db),
                    xytext=(-5, 6),
                    textcoords="offset points",
                    ha="right",
                    color=styles[codecs[0].label].colour,
                    fontsize=8,
                )
        axes.set_title(plain(experiment.title), fontsize=10)
        axes.set_xlabel("rate [kbit/s]")
        axes.set_ylabel("luma PSNR [dB]")
        axes.grid(color="#dddddd", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.legend(loc="best", frameon=True, fontsize=8 if len(curves) > 4 else 10)
        return {suffix: contents(figure, suffix) for suffix in SUFFIXES}


def _line_options(style: Style, label: str) -> dict[str, Any]:
    """Return colour, markers and label of a line for matplotlib."""
    face = "none" if style.is_open else style.colour
    return {"color": style.colour, "marker": style.marker, "markerfacecolor": face, "label": plain(label)}


def _legend(curve: Curve, anchor: Curve | None) -> str:
    if anchor is None or anchor is curve:
        return curve.label
    rates = Comparison("", anchor, curve).rates
    luma, in_colour = rates["luma"], rates["colour"]
    if isinstance(luma, str):
        return curve.label
    against = "" if anchor.label == ANCHOR_LABEL else f" against {anchor.label}"
    colour = "" if isinstance(in_colour, str) else f", colour {in_colour.value:+.1f} %"
    return f"{curve.label} (BD-rate{against} {luma.value:+.1f} %{colour})"


def render_rate_cost(
    points: Sequence[RateCost], styles: Mapping[str, Style], reference: str = ANCHOR_LABEL
) -> dict[str, bytes]:
    """Draw rate against cost; return the files by suffix."""
    with new_figure(SIZE_INCHES) as figure:
        from matplotlib.ticker import FuncFormatter

        axes = figure.add_subplot()
        for point in points:
            options = _line_options(styles[point.label], point.label)
            axes.plot([point.cost_ms], [point.bd_rate_percent], linestyle="none", markersize=8, **options)
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        # Labels between powers of ten: only 2 and 5 times these.
        minor = FuncFormatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")
        axes.xaxis.set_minor_formatter(minor)
        axes.set_xlabel("processor time of encoding a frame [ms]")
        axes.set_ylabel(plain(f"BD-rate against {reference} [%]"))
        axes.grid(color="#dddddd", linewidth=0.8, which="both")
        axes.set_axisbelow(True)
        axes.legend(loc="best", fontsize=8)
        return {suffix: contents(figure, suffix) for suffix in SUFFIXES}
