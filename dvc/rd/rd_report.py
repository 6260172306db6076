"""The report of an experiment: tables in Markdown with a plot for each sequence, or one page."""

import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from dvc import cli
from dvc.config import VARIANTS
from dvc.errors import DvcError
from dvc.files import atomic_output
from dvc.rd.anchors import ANCHOR_CODECS
from dvc.rd.comparison import NOTHING, RateCost, Verdict, bd_rate_text, measure_titles, rate_costs, verdicts
from dvc.rd.rd_curves import ANCHOR_LABEL, Curve, Experiment, compare_curves, experiments, table_measures
from dvc.rd.rd_results import IMPORTED, PointResult
from dvc.rd.specification import NO_FEEDBACK

RATE_COST_SLUG = "rate-against-cost"
RATE_COST_CAPTION = (
    "Mean difference in rate at equal PSNR, and processor time of encoding a frame without reading the input "
    "and loading code: means over the sequences that have both of a codec and of the reference; the lower "
    "left is best"
)
Cell = Callable[[PointResult], str]


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
    from dvc.rd.rd_page import write_page

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
    from dvc.rd.rd_plots import curve_styles, render_experiment, render_rate_cost

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
    """Return the number of points, when they were measured, and by which code."""
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
    "encode CPU ms per key frame": lambda point: number_text(point.type_ms("key"), 1),
    "per WZ frame": lambda point: number_text(point.type_ms("wz"), 1),
}
"""Columns of the table of a curve, by title."""
