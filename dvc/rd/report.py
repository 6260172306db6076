"""The report of an experiment: tables in Markdown and a plot per sequence, from results alone."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from dvc.errors import DvcError
from dvc.files import atomic_output
from dvc.rd.anchors.codecs import ANCHOR_CODECS
from dvc.rd.anchors.reference import REFERENCE_LABELS
from dvc.rd.curves import ANCHOR_LABEL, Curve, Experiment, bd_text, compare_curves, experiments
from dvc.rd.frames import bit_shares, num_of_types
from dvc.rd.plots import SUFFIXES, curve_styles, render_experiment
from dvc.rd.results import PointResult

NOTHING = "–"
Cell = Callable[[PointResult], str]


def write_report(results: Sequence[PointResult], path: Path, anchor: str = ANCHOR_LABEL) -> list[Path]:
    """Write the report and its pictures.

    Parameters
    ----------
    results : sequence of PointResult
        What was measured.
    path : Path
        Markdown file; the pictures lie beside it and begin with its name.
    anchor : str, optional
        Label of the curve that all others are compared with.

    Returns
    -------
    list of Path
        All files written, the report first.

    Raises
    ------
    DvcError
        If they cannot be written.
    """
    return write_reports(results, [path], anchor)


def write_reports(
    results: Sequence[PointResult],
    outputs: Sequence[Path],
    anchor: str = ANCHOR_LABEL,
    *,
    figures: Path | None = None,
    notes: Sequence[str] = (),
    pictures: bool = True,
) -> list[Path]:
    """Write the report in several forms.

    Parameters
    ----------
    results : sequence of PointResult
        What was measured.
    outputs : sequence of Path
        Files that end with ``.html`` (a page that holds everything) or ``.md`` (needs the plots).
    anchor : str, optional
        Label of the curve that all others are compared with; the page lets its reader choose others.
    figures : Path, optional
        Folder for the plots; by default that of the ``.md``, and without one they are not written.
    notes : sequence of str, optional
        What a reader of the page must know besides.
    pictures : bool, optional
        Whether the page shows decoded frames.

    Returns
    -------
    list of Path
        All files written, the reports first.

    Raises
    ------
    DvcError
        If they cannot be written.
    """
    from dvc.rd.page import write_page

    found = experiments(results)
    styles = curve_styles(found)
    texts = [path for path in outputs if path.suffix == ".md"]
    suffixes = SUFFIXES if texts or figures else (".svg",)
    drawn = {one.slug: render_experiment(one, styles, suffixes) for one in found}
    for path in set(outputs) - set(texts):
        write_page(results, path, anchor, notes=notes, pictures=pictures, drawn=drawn)
    if not texts and figures is None:
        return list(outputs)
    folder = texts[0].parent if figures is None else figures
    stem = (texts or outputs)[0].stem
    written = _write_figures(drawn, folder, stem)
    for path in texts:
        names = {slug: os.path.relpath(paths[0], path.parent) for slug, paths in written.items()}
        with atomic_output(path) as temporary:
            temporary.write_text(report_text(found, results, names, anchor), encoding="utf-8")
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
    anchor: str = ANCHOR_LABEL,
) -> str:
    """Return the report.

    Parameters
    ----------
    found : sequence of Experiment
        The curves.
    results : sequence of PointResult
        The points that they are made of.
    pictures : dict of str to str
        Name of the picture of each experiment, by its slug.
    anchor : str, optional
        Label of the curve that all others are compared with.

    Returns
    -------
    str
        Markdown.
    """
    parts = ["# Rate-distortion report\n", preface(results), "## BD-rate\n", bd_table(found, anchor)]
    for experiment in found:
        parts += [f"## {experiment.name}\n", f"{experiment.title}.\n"]
        parts.append(f"![Rate-distortion curves of {experiment.name}]({pictures[experiment.slug]})\n")
        for curve in experiment.curves:
            parts += [f"### {experiment.name}, {curve.label}\n", points_table(curve)]
        parts += ["<details><summary>Commands</summary>\n", _commands(experiment), "</details>\n"]
    return "\n".join(parts)


def bd_table(found: Sequence[Experiment], anchor: str = ANCHOR_LABEL) -> str:
    """Return the table of BD-rates.

    Parameters
    ----------
    found : sequence of Experiment
        The curves.
    anchor : str, optional
        Label of the curve that all others are compared with.

    Returns
    -------
    str
        Markdown.
    """
    rows = []
    for experiment in found:
        reference = experiment.anchor(anchor)
        for curve in experiment.curves:
            if curve.label == anchor or curve.has_lossless_keys or (curve.is_anchor and reference is None):
                continue
            text = NOTHING if reference is None else bd_text(compare_curves(reference, curve))
            rows.append([experiment.name, curve.label, text])
    head = ["sequence", "codec", f"BD-rate against {anchor} (overlap, points)"]
    note = "Mean difference in rate at equal PSNR (PCHIP on the logarithm of the rate); negative is better.\n"
    return note + "\n" + table(head, rows)


def points_table(curve: Curve) -> str:
    """Return the table of the points of a curve.

    Parameters
    ----------
    curve : Curve
        The curve.

    Returns
    -------
    str
        Markdown; columns that no point has anything for are left out.
    """
    return table(*points_cells(curve))


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


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table.

    Parameters
    ----------
    head : sequence of str
        Titles.
    rows : sequence of sequence of str
        Cells.

    Returns
    -------
    str
        Lines, the last one with its end.
    """
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(map(_escaped, line)) + " |\n" for line in lines)


def _escaped(cell: str) -> str:
    """Write a text so that it is neither the end of a cell nor markup."""
    return cell.replace("|", "\\|").replace("<", "&lt;")


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


def _encode_ms(name: str, wyner_ziv: bool) -> Cell:
    def cell(point: PointResult) -> str:
        count = _num_wyner_ziv(point)
        count = count if wyner_ziv else point.data["totals"]["frames"] - count
        value = point.data["times"].get(name)
        return NOTHING if not count or value is None else f"{1000 * value / count:.1f}"

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
    "header %": _share("header", "tracks"),
    "requests per WZ frame": _per_wyner_ziv("num_requests", "{:.0f}"),
    "decode s per WZ frame": _per_wyner_ziv("decode_s", "{:.2f}"),
    "encode CPU ms per key frame": _encode_ms("key_encode_cpu_s", False),
    "per WZ frame": _encode_ms("wz_encode_cpu_s", True),
}
"""Columns of the table of a curve, by title."""


def preface(results: Sequence[PointResult]) -> str:
    """Say what a report rests on.

    Parameters
    ----------
    results : sequence of PointResult
        What was measured.

    Returns
    -------
    str
        Number of points, dates, versions of the code with a warning if there are several, what a rate is.
    """
    results = [r for r in results if r.data["codec"] not in REFERENCE_LABELS]
    codes = sorted(
        {(r.data["code"]["version"], r.data["code"].get("commit") or "no commit") for r in results}
    )
    digests = code_digests(results)
    dates = sorted(str(r.data.get("date", ""))[:10] for r in results)
    code = ", ".join(f"dvc3d {version} ({commit})" for version, commit in codes)
    mixed = f" The points come from {len(digests)} versions of the code." if len(digests) > 1 else ""
    period = dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
    return (
        f"{len(results)} points, measured {period} with {code}.{mixed} "
        "Rates of distributed codecs are sizes of punctured streams, each decoded to the same frames "
        "by a fresh process, rates of others are sizes of whole files; PSNRs are of luma, means of frames.\n"
    )


def code_digests(results: Sequence[PointResult]) -> set[str]:
    """Return the versions of the code that made points of the project's own codecs.

    Parameters
    ----------
    results : sequence of PointResult
        What was measured.

    Returns
    -------
    set of str
        Digests; there should be one.
    """
    others = {*ANCHOR_CODECS, *REFERENCE_LABELS}
    return {result.data["code"]["digest"] for result in results if result.data["codec"] not in others}


def _commands(experiment: Experiment) -> str:
    lines = [
        line
        for curve in experiment.curves
        for point in curve.points
        for line in point.data.get("commands", ())
    ]
    return "```\n" + "".join(f"{line}\n" for line in lines) + "```\n"
