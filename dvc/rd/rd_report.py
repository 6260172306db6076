"""The report of an experiment: pages, and Markdown with plots of the curves."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc.errors import DvcError
from dvc.files import atomic_output
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
from dvc.rd.rd_page import write_page
from dvc.rd.rd_results import PointResult
from dvc.rd.rd_tables import (
    RATE_COST_CAPTION,
    Style,
    curve_styles,
    escaped,
    fenced,
    points_cells,
    preface,
    rate_cost_cells,
    table,
)
from dvc.web.plotting import MATPLOTLIB_DASHES, SIZE_INCHES, SUFFIXES, contents, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RATE_COST_SLUG = "rate-against-cost"
LABEL_ROOM_PX = 14


def write_reports(
    results: Sequence[PointResult],
    outputs: Sequence[Path],
    anchor: str = ANCHOR_LABEL,
    *,
    figures: Path | None = None,
    notes: Sequence[str] = (),
    pictures: bool = True,
) -> list[Path]:
    """Write the report as pages (.html) and as Markdown (.md) with its plots; return all files."""
    found = experiments(results)
    judged = verdicts(found)
    texts = [path for path in outputs if path.suffix == ".md"]
    for path in set(outputs) - set(texts):
        write_page(results, path, anchor, notes=notes, pictures=pictures, judged=judged)
    if not texts and figures is None:
        return list(outputs)
    folder = texts[0].parent if figures is None else figures
    plots = _write_plots(found, anchor, folder, (texts or outputs)[0].stem)
    for path in texts:
        names = {slug: os.path.relpath(paths[0], path.parent) for slug, paths in plots.items()}
        with atomic_output(path) as temporary:
            temporary.write_text(report_text(found, results, names, judged, anchor), encoding="utf-8")
    return [*outputs, *(file for paths in plots.values() for file in paths)]


def _write_plots(found: Sequence[Experiment], anchor: str, folder: Path, stem: str) -> dict[str, list[Path]]:
    """Write the plots of all experiments, and of rate against cost; return the files by slug."""
    styles = curve_styles(found)
    drawn = {one.slug: render_experiment(one, styles, anchor) for one in found}
    costs = rate_costs(found, anchor)
    if len(costs) > 1:
        drawn[RATE_COST_SLUG] = render_rate_cost(costs, styles, anchor)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise DvcError(f"cannot write to {folder}: {err.strerror}") from err
    written: dict[str, list[Path]] = {}
    for slug, files in drawn.items():
        for suffix, data in files.items():
            path = folder / f"{stem}-{slug}{suffix}"
            with atomic_output(path) as temporary:
                temporary.write_bytes(data)
            written.setdefault(slug, []).append(path)
    return written


def report_text(
    found: Sequence[Experiment],
    results: Sequence[PointResult],
    pictures: dict[str, str],
    judged: Sequence[Verdict] = (),
    anchor: str = ANCHOR_LABEL,
) -> str:
    """Return the report as Markdown; `pictures` are file names by slug."""
    parts = ["# Rate-distortion report\n", f"{preface(results)}\n", "## BD-rate\n", _bd_table(found, anchor)]
    parts += [_all_pairs(judged), _rate_cost(found, anchor, pictures)]
    for experiment in found:
        name = escaped(experiment.name)
        parts += [f"## {name}\n", f"{escaped(experiment.title)}.\n"]
        parts.append(f"![Rate-distortion curves of {name}]({pictures[experiment.slug]})\n")
        for curve in experiment.curves:
            parts += [f"### {name}, {escaped(curve.label)}\n", table(*points_cells(curve))]
        points = [point for curve in experiment.curves for point in curve.points]
        commands = fenced([line for point in points for line in point.commands])
        parts += ["<details><summary>Commands</summary>\n", commands, "</details>\n"]
    return "\n".join(parts)


def _bd_table(found: Sequence[Experiment], anchor: str) -> str:
    """Return the table of BD-rates against one curve."""
    rows, measures = [], table_measures(any(experiment.in_colour for experiment in found))
    for experiment in found:
        reference = experiment.anchor(anchor)
        for curve in experiment.curves:
            if curve.label == anchor or curve.has_lossless_keys or (curve.is_anchor and reference is None):
                continue
            texts = [
                NOTHING
                if reference is None
                else bd_rate_text(compare_curves(reference, curve, "rate", measure))
                for measure in measures
            ]
            rows.append([experiment.name, curve.label, *texts])
    titles = [f"BD-rate against {anchor}{one} (overlap, points)" for one in measure_titles(measures)]
    note = "Mean difference in rate at equal PSNR (PCHIP on the logarithm of the rate); negative is better.\n"
    return note + "\n" + table(["sequence", "codec", *titles], rows)


def _all_pairs(judged: Sequence[Verdict]) -> str:
    """Return the BD-rates of every curve against every other, and their means."""
    if not judged:
        return ""
    parts = [
        "## Every curve against every other\n",
        "BD-rates; a mean is followed by the number of sequences with a figure for both curves.\n",
    ]
    for verdict in judged:
        rows = [[name, *(cell.text for cell in cells)] for name, cells in verdict.matrix]
        parts += [
            f"<details><summary>Against {escaped(verdict.anchor)}</summary>\n",
            table(["sequence", *verdict.columns], rows),
            "</details>\n",
        ]
    return "\n".join(parts)


def _rate_cost(found: Sequence[Experiment], anchor: str, pictures: dict[str, str]) -> str:
    """Return rate against cost as a picture and a table, if it was drawn."""
    if RATE_COST_SLUG not in pictures:
        return ""
    picture = f"![BD-rate over the processor time of the encoder]({pictures[RATE_COST_SLUG]})\n"
    cells = table(*rate_cost_cells(rate_costs(found, anchor), anchor))
    return "\n".join(["## Rate against cost of encoding\n", f"{RATE_COST_CAPTION}.\n", picture, cells])


def render_experiment(
    experiment: Experiment, styles: Mapping[str, Style], anchor: str = ANCHOR_LABEL
) -> dict[str, bytes]:
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
        if any(len(curve.points) > 1 for curve in codecs):
            _zoom_to(axes, codecs)
        if codecs:
            _name_points(axes, codecs[0], styles[codecs[0].label].colour)
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


def _name_points(axes: "Axes", curve: Curve, colour: str) -> None:
    """Write the levels next to the points of a curve if they have room."""
    last = (float("-inf"), float("-inf"))
    for point in curve.points:
        x, y = axes.transData.transform((point.rate_kbps, point.psnr_y_db))
        if max(abs(x - last[0]), abs(y - last[1])) < LABEL_ROOM_PX:
            continue
        last = (x, y)
        place: dict[str, Any] = {"xytext": (-5, 6), "textcoords": "offset points", "ha": "right"}
        axes.annotate(point.level, (point.rate_kbps, point.psnr_y_db), color=colour, fontsize=8, **place)


def _zoom_to(axes: "Axes", curves: list[Curve]) -> None:
    """Show the range of some curves; anchors may leave it."""
    rates = [rate for curve in curves for rate in curve.rates_kbps]
    psnrs = [psnr for curve in curves for psnr in curve.psnrs_y_db]
    width, height = max(rates) - min(rates), max(max(psnrs) - min(psnrs), 1.0)
    axes.set_xlim(max(0.0, min(rates) - 0.2 * width), max(rates) + 0.3 * max(width, 0.1 * max(rates)))
    axes.set_ylim(min(psnrs) - 0.15 * height, max(psnrs) + 0.12 * height)


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
        axes.xaxis.set_minor_formatter(FuncFormatter(_minor_label))
        axes.set_xlabel("processor time of encoding a frame [ms]")
        axes.set_ylabel(plain(f"BD-rate against {reference} [%]"))
        axes.grid(color="#dddddd", linewidth=0.8, which="both")
        axes.set_axisbelow(True)
        axes.legend(loc="best", fontsize=8)
        return {suffix: contents(figure, suffix) for suffix in SUFFIXES}


def _minor_label(value: float, _: object) -> str:
    """Label only 2 and 5 times powers of ten between the powers themselves."""
    return f"{value:g}" if f"{value:e}"[0] in "25" else ""
