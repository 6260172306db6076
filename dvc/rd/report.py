"""The report of an experiment: tables in Markdown and a plot per sequence, from results alone."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dvc.errors import DvcError
from dvc.files import atomic_output
from dvc.rd.curves import ANCHOR_LABEL, Experiment, experiments
from dvc.rd.differences import bd_text, compare_curves, told_measures
from dvc.rd.plots import curve_styles, render_experiment
from dvc.rd.point_result import PointResult
from dvc.rd.rate_cost import CAPTION, rate_cost_cells, rate_costs, render_rate_cost
from dvc.rd.tables import NOTHING, escaped, fenced, points_cells, preface, table
from dvc.web.plotting import SUFFIXES

if TYPE_CHECKING:
    from dvc.rd.page.verdict import Verdict

RATE_COST_SLUG = "rate-against-cost"


def write_reports(
    results: Sequence[PointResult],
    outputs: Sequence[Path],
    anchor: str = ANCHOR_LABEL,
    *,
    figures: Path | None = None,
    notes: Sequence[str] = (),
    pictures: bool = True,
) -> list[Path]:
    """Write the report in several forms."""
    from dvc.rd.page import write_page
    from dvc.rd.page.verdict import verdicts

    found = experiments(results)
    judged = verdicts(found)
    styles = curve_styles(found)
    texts = [path for path in outputs if path.suffix == ".md"]
    suffixes = SUFFIXES if texts or figures else (".svg",)
    drawn = {one.slug: render_experiment(one, styles, suffixes, anchor) for one in found}
    for path in set(outputs) - set(texts):
        write_page(results, path, anchor, notes=notes, pictures=pictures, drawn=drawn, judged=judged)
    if not texts and figures is None:
        return list(outputs)
    folder = texts[0].parent if figures is None else figures
    stem = (texts or outputs)[0].stem
    costs = rate_costs(found, anchor)
    if len(costs) > 1:
        drawn[RATE_COST_SLUG] = render_rate_cost(costs, styles, anchor)
    written = _write_figures(drawn, folder, stem)
    for path in texts:
        names = {slug: os.path.relpath(paths[0], path.parent) for slug, paths in written.items()}
        with atomic_output(path) as temporary:
            temporary.write_text(report_text(found, results, names, judged, anchor), encoding="utf-8")
    return [*outputs, *(file for paths in written.values() for file in paths)]


def _write_figures(drawn: dict[str, dict[str, bytes]], folder: Path, stem: str) -> dict[str, list[Path]]:
    """Write the plots of each experiment; its name is part of theirs."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise DvcError(f"cannot write to {folder}: {err.strerror}") from err
    written: dict[str, list[Path]] = {}
    for slug, contents in drawn.items():
        for suffix, data in contents.items():
            path = folder / f"{stem}-{slug}{suffix}"
            with atomic_output(path) as temporary:
                temporary.write_bytes(data)
            written.setdefault(slug, []).append(path)
    return written


def report_text(
    found: Sequence[Experiment],
    results: Sequence[PointResult],
    pictures: dict[str, str],
    judged: Sequence["Verdict"] = (),
    anchor: str = ANCHOR_LABEL,
) -> str:
    """Return the report."""
    parts = ["# Rate-distortion report\n", preface(results), "## BD-rate\n", _bd_table(found, anchor)]
    parts += [_all_pairs(judged), _rate_cost(found, anchor, pictures)]
    for experiment in found:
        name = escaped(experiment.name)
        parts += [f"## {name}\n", f"{escaped(experiment.title)}.\n"]
        parts.append(f"![Rate-distortion curves of {name}]({pictures[experiment.slug]})\n")
        for curve in experiment.curves:
            parts += [f"### {name}, {escaped(curve.label)}\n", table(*points_cells(curve))]
        parts += ["<details><summary>Commands</summary>\n", _commands(experiment), "</details>\n"]
    return "\n".join(parts)


def _bd_table(found: Sequence[Experiment], anchor: str) -> str:
    """Return the table of BD-rates against one curve."""
    rows, measures = [], told_measures(any(experiment.in_colour for experiment in found))
    for experiment in found:
        reference = experiment.anchor(anchor)
        for curve in experiment.curves:
            if curve.label == anchor or curve.has_lossless_keys or (curve.is_anchor and reference is None):
                continue
            texts = [
                NOTHING if reference is None else bd_text(compare_curves(reference, curve, "rate", measure))
                for measure in measures
            ]
            rows.append([experiment.name, curve.label, *texts])
    told = [f", {measure}" for measure in measures] if len(measures) > 1 else [""]
    head = ["sequence", "codec", *(f"BD-rate against {anchor}{one} (overlap, points)" for one in told)]
    note = "Mean difference in rate at equal PSNR (PCHIP on the logarithm of the rate); negative is better.\n"
    return note + "\n" + table(head, rows)


def _rate_cost(found: Sequence[Experiment], anchor: str, pictures: dict[str, str]) -> str:
    """Return rate against cost as a picture and a table; nothing without a picture."""
    if RATE_COST_SLUG not in pictures:
        return ""
    picture = f"![BD-rate over the processor time of the encoder]({pictures[RATE_COST_SLUG]})\n"
    cells = table(*rate_cost_cells(rate_costs(found, anchor), anchor))
    return "\n".join(["## Rate against cost of encoding\n", f"{CAPTION}.\n", picture, cells])


def _all_pairs(judged: Sequence["Verdict"]) -> str:
    """Return the BD-rates of every curve against every other, and their means; nothing without two."""
    if not judged:
        return ""
    parts = [
        "## Every curve against every other\n",
        "BD-rates; the number beside a mean is that of the sequences that have a figure for both curves.\n",
    ]
    for verdict in judged:
        rows = [[name, *(cell.text for cell in cells)] for name, cells in verdict.matrix]
        parts += [
            f"<details><summary>Against {escaped(verdict.anchor)}</summary>\n",
            table(["sequence", *verdict.columns], rows),
            "</details>\n",
        ]
    return "\n".join(parts)


def _commands(experiment: Experiment) -> str:
    lines = [
        line
        for curve in experiment.curves
        for point in curve.points
        for line in point.data.get("commands", ())
    ]
    return fenced(lines)
