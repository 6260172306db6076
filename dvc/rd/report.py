"""The report of an experiment: tables in Markdown and a plot per sequence, from results alone."""

from collections.abc import Callable, Sequence
from pathlib import Path

from dvc.files import atomic_output
from dvc.rd.curves import ANCHOR_LABEL, Curve, Experiment, bd_text, compare_curves, experiments
from dvc.rd.plots import plot_experiment
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
    found = experiments(results)
    pictures = {one.slug: plot_experiment(one, path.with_name(f"{path.stem}-{one.slug}")) for one in found}
    names = {slug: paths[0].name for slug, paths in pictures.items()}
    with atomic_output(path) as temporary:
        temporary.write_text(report_text(found, results, names, anchor), encoding="utf-8")
    return [path, *(picture for paths in pictures.values() for picture in paths)]


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
    parts = ["# Rate-distortion report\n", _preface(results), "## BD-rate\n", bd_table(found, anchor)]
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
            if curve.label == anchor or (curve.is_anchor and reference is None):
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
    rows = [[cell(point) for cell in COLUMNS.values()] for point in curve.points]
    kept = [i for i in range(len(COLUMNS)) if any(row[i] != NOTHING for row in rows)]
    return table([list(COLUMNS)[i] for i in kept], [[row[i] for i in kept] for row in rows])


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
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)


def _total(name: str, form: str) -> Cell:
    def cell(point: PointResult) -> str:
        value = point.total(name)
        return NOTHING if value is None else form.format(value)

    return cell


def _share(*names: str) -> Cell:
    def cell(point: PointResult) -> str:
        bits = point.data["totals"]["bits"]
        return f"{100 * sum(bits.get(name, 0) for name in names) / sum(bits.values()):.1f}"

    return cell


def _num_wyner_ziv(point: PointResult) -> int:
    return sum(frame["type"] == "wz" for frame in point.data.get("per_frame", ()))


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
    "parity %": _share("parity"),
    "CRC %": _share("crc"),
    "header %": _share("header", "tracks"),
    "requests per WZ frame": _per_wyner_ziv("num_requests", "{:.0f}"),
    "decode s per WZ frame": _per_wyner_ziv("decode_s", "{:.2f}"),
    "encode CPU ms (start-up included) per key frame": _encode_ms("key_encode_cpu_s", False),
    "per WZ frame": _encode_ms("wz_encode_cpu_s", True),
}
"""Columns of the table of a curve, by title."""


def _preface(results: Sequence[PointResult]) -> str:
    codes = sorted(
        {(r.data["code"]["version"], r.data["code"].get("commit") or "no commit") for r in results}
    )
    digests = {r.data["code"]["digest"] for r in results}
    dates = sorted(str(r.data.get("date", ""))[:10] for r in results)
    code = ", ".join(f"dvc3d {version} ({commit})" for version, commit in codes)
    mixed = f" The points come from {len(digests)} versions of the code." if len(digests) > 1 else ""
    return (
        f"{len(results)} points, measured {dates[0]} to {dates[-1]} with {code}.{mixed} "
        "Every rate is the size of a punctured stream that a fresh process decoded to the same frames; "
        "PSNRs are of luma, means of the frames.\n"
    )


def _commands(experiment: Experiment) -> str:
    lines = [
        line
        for curve in experiment.curves
        for point in curve.points
        for line in point.data.get("commands", ())
    ]
    return "```\n" + "".join(f"{line}\n" for line in lines) + "```\n"
