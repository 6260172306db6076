"""Measure the figures that are asked of the project, and write `docs/figures.json` and `docs/figures.md`.

A run that was interrupted goes on where it stopped; once it is through, the next run measures everything
again. With ``--quick`` the measurements are only tried out, and nothing is written to `docs`.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import (
    anchor_figures,
    anchor_rd_figures,
    codec_figures,
    rd_figures,
    report_figures,
    reproduction_figures,
    robustness_figures,
    sfm_figures,
    si_figures,
    tracks_cost_figures,
    tracks_figures,
    tracks_limit_figures,
    tracks_options_figures,
    tracks_rd_figures,
    turbo_figures,
)
from benchmarks.harness import FOREMAN, RESULTS, Figure, MissingClip, Setting
from dvc import cli
from dvc.errors import ConfigError, DvcError
from dvc.rd.provenance import code_version

PROG = "python -m benchmarks.figures"
EXAMPLES = """\
  python -m benchmarks.figures                        all figures; hours
  python -m benchmarks.figures --area turbo           those of one area
  python -m benchmarks.figures --area rd --clip box   one sequence
  python -m benchmarks.figures --quick                try every measurement out; minutes
  python -m benchmarks.figures --list                 what there is
"""
DOCUMENT = Path("docs") / "figures.json"
MODULES = (
    turbo_figures,
    codec_figures,
    rd_figures,
    report_figures,
    reproduction_figures,
    anchor_figures,
    anchor_rd_figures,
    robustness_figures,
    sfm_figures,
    si_figures,
    tracks_figures,
    tracks_limit_figures,
    tracks_options_figures,
    tracks_cost_figures,
    tracks_rd_figures,
)
AREAS_BY_FRAMES = ("rd", "tracks")
ROWS_BY_FRAMES = frozenset(figure.name for figure in anchor_rd_figures.FIGURES)
"""What depends on the number of frames of CIF clips."""
Row = dict[str, Any]
Key = tuple[str, str, str | None]


@dataclass(frozen=True)
class Unit:
    """One row to measure: a figure on one clip."""

    figure: Figure
    clip: str | None

    @property
    def key(self) -> Key:
        """What tells it from all other rows."""
        return self.figure.area, self.figure.name, self.clip


def all_units() -> list[Unit]:
    """List the rows that there are.

    Returns
    -------
    list of Unit
        In the order of the document.
    """
    return [Unit(figure, clip) for module in MODULES for figure in module.FIGURES for clip in figure.clips]


def selected_units(area: str | None, name: str | None, clip: str | None, quick: bool) -> list[Unit]:
    """Choose rows.

    Parameters
    ----------
    area, name, clip : str or None
        All that have these; None accepts any.
    quick : bool
        Only the first clip of every figure, unless one is named.

    Returns
    -------
    list of Unit
        At least one.

    Raises
    ------
    ConfigError
        If there is none.
    """
    units = [
        unit
        for unit in all_units()
        if area in (None, unit.figure.area) and name in (None, unit.figure.name) and clip in (None, unit.clip)
    ]
    if quick and clip is None:
        units = [unit for unit in units if unit.clip == unit.figure.clips[0]]
    if not units:
        areas = ", ".join(dict.fromkeys(unit.figure.area for unit in all_units()))
        raise ConfigError(f"no figure of that area, name and clip; areas are {areas}; see --list")
    return units


def measure(unit: Unit, setting: Setting) -> tuple[Row, bool]:
    """Measure one row.

    Parameters
    ----------
    unit : Unit
        The row.
    setting : Setting
        How thoroughly.

    Returns
    -------
    row : dict
        As it stands in the document.
    finished : bool
        False if the measurement failed.
    """
    try:
        row = unit.figure.row(unit.clip, unit.figure.measure(setting, unit.clip))
        return with_frames(row, setting.frames), True
    except MissingClip as err:
        return unit.figure.row(unit.clip, None, str(err)), True
    except (DvcError, OSError) as err:
        return unit.figure.row(unit.clip, None, f"the measurement failed: {cli.one_line(err)}"), False


def with_frames(row: Row, frames: int) -> Row:
    """Say in the command of a row how many frames of CIF clips it covers, where that is not the default.

    Parameters
    ----------
    row : dict
        Row of a figure.
    frames : int
        Frames of CIF curves.

    Returns
    -------
    dict
        The row.
    """
    varies = row["area"] in AREAS_BY_FRAMES or row["name"] in ROWS_BY_FRAMES
    if not varies or row["clip"] == FOREMAN or frames == Setting.frames:
        return row
    return row | {"command": f"{row['command']} --frames {frames}", "note": f"{frames} frames"}


class Campaign:
    """Rows that were measured since the last complete run, in a file, so that an interrupted run goes on.

    Parameters
    ----------
    path : Path
        The file; it need not exist.
    frames : int
        Of CIF curves; rows of other numbers do not count.
    """

    def __init__(self, path: Path, frames: int) -> None:
        self._path = path
        self._rows: dict[Key, Row] = {}
        self._made_by = {"code": code_version().digest, "frames": frames}
        for row in read_rows(path):
            if self._made_by.items() <= row.items():
                self._rows[row_key(row)] = row

    def __contains__(self, key: Key) -> bool:
        """Tell whether a row is done."""
        return key in self._rows

    def add(self, row: Row) -> None:
        """Enter a row that is done.

        Parameters
        ----------
        row : dict
            The row.
        """
        self._rows[row_key(row)] = {**row, **self._made_by}
        write_rows(self._path, list(self._rows.values()))

    def close(self, keys: Sequence[Key]) -> None:
        """Forget rows, because all that were to be measured are.

        Parameters
        ----------
        keys : sequence of tuple
            Of the rows.
        """
        self._rows = {key: row for key, row in self._rows.items() if key not in keys}
        write_rows(self._path, list(self._rows.values()))


def row_key(row: Row) -> Key:
    """Return what tells a row from all others.

    Parameters
    ----------
    row : dict
        A row of the document.

    Returns
    -------
    tuple
        Area, name and clip.
    """
    return row["area"], row["name"], row["clip"]


def read_rows(path: Path) -> list[Row]:
    """Read rows; the inverse of `write_rows`.

    Parameters
    ----------
    path : Path
        JSON file.

    Returns
    -------
    list of dict
        The rows; none if there is no such file.

    Raises
    ------
    DvcError
        If the file is damaged.
    """
    if not path.exists():
        return []
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        return [row for row in rows if row_key(row)]
    except (ValueError, TypeError, KeyError) as err:
        raise DvcError(f"{path}: damaged: {err!r}") from err


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write rows.

    Parameters
    ----------
    path : Path
        JSON file; its folder is made if needed.
    rows : sequence of dict
        The rows.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    cli.write_json(path, list(rows))


def merged_rows(old: Sequence[Row], new: Sequence[Row]) -> list[Row]:
    """Put new rows in the place of old ones.

    A row that could not be measured now does not replace what was measured before. Rows of figures that are
    not defined any more go; figures that were never measured have a row that says so.

    Parameters
    ----------
    old, new : sequence of dict
        Rows.

    Returns
    -------
    list of dict
        One row per figure and clip, in the order of the document.
    """
    rows = {row_key(row): row for row in old}
    for row in new:
        known = rows.get(row_key(row))
        if row["got"] is not None or known is None or known["got"] is None:
            rows[row_key(row)] = row
    return [
        rows.get(unit.key) or unit.figure.row(unit.clip, None, "not measured yet") for unit in all_units()
    ]


def document_text(rows: Sequence[Row]) -> str:
    """Return the document that people read.

    Parameters
    ----------
    rows : sequence of dict
        All rows.

    Returns
    -------
    str
        Markdown.
    """
    lines = [
        "# Figures\n",
        "What is asked of the project, and what was measured. Made by `make figures` from `figures.json`; "
        "no number is typed in by hand. *Holds* is empty where only the true figure is asked for.\n",
    ]
    for area in dict.fromkeys(row["area"] for row in rows):
        chosen = [row for row in rows if row["area"] == area]
        lines += [f"## {area}\n", _table(chosen, any(row["thesis"] for row in chosen))]
    return "\n".join(lines)


def _table(rows: Sequence[Row], with_thesis: bool) -> str:
    head = ["figure", "clip", "asked", *(["thesis"] if with_thesis else []), "measured", "holds", "date"]
    lines = [head, ["---"] * len(head)]
    for row in rows:
        note = f" ({row['note']})" if row["note"] and row["got"] is not None else ""
        measured = f"{row['got']}{note}" if row["got"] is not None else f"*{row['note']}*"
        holds = {True: "yes", False: "**no**", None: ""}[row["holds"]]
        thesis = [row["thesis"] or ""] if with_thesis else []
        lines.append(
            [row["title"], row["clip"] or "", row["asked"], *thesis, measured, holds, row["date"] or ""]
        )
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)


def _write_document(new: Sequence[Row]) -> None:
    from dvc.files import atomic_output

    rows = merged_rows(read_rows(DOCUMENT), new)
    write_rows(DOCUMENT, rows)
    with atomic_output(DOCUMENT.with_suffix(".md")) as temporary:
        temporary.write_text(document_text(rows), encoding="utf-8")


def _parser() -> argparse.ArgumentParser:
    parser = cli.ArgumentParser(PROG, "Measure the figures that are asked of the project.", EXAMPLES)
    parser.add_argument("--area", help="only the figures of this area")
    parser.add_argument("--name", help="only the figures of this name")
    parser.add_argument("--clip", help="only on this sequence")
    parser.add_argument("--quick", action="store_true", help="try out; nothing is written to docs")
    parser.add_argument(
        "--frames", type=cli.integer(3, 10**6), default=51, metavar="N", help="of CIF curves; default: 51"
    )
    parser.add_argument(
        "--jobs",
        type=cli.integer(1, 64),
        default=1,
        metavar="N",
        help="points of a curve at a time; default: 1",
    )
    parser.add_argument(
        "--any-version", action="store_true", help="keep points that other versions of the code have measured"
    )
    parser.add_argument("--again", action="store_true", help="forget what an interrupted run has measured")
    parser.add_argument("--list", action="store_true", help="list the figures")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; those of the process by default.

    Returns
    -------
    int
        Exit status: 0, or 2 for bad input and for measurements that failed.
    """
    arguments = _parser().parse_args(argv)
    return cli.run(PROG, lambda: _run(arguments))


def _run(arguments: argparse.Namespace) -> int:
    units = selected_units(arguments.area, arguments.name, arguments.clip, arguments.quick)
    if arguments.list:
        for unit in units:
            print(f"{unit.figure.area:12}{unit.figure.name:28}{unit.clip or '':18}{unit.figure.asked}")
        return 0
    folder = RESULTS / "quick" if arguments.quick else RESULTS
    setting = Setting(arguments.quick, arguments.frames, arguments.jobs, folder, arguments.any_version)
    state = folder / "state.json"
    if arguments.again:
        state.unlink(missing_ok=True)
    campaign = Campaign(state, arguments.frames)
    failed = 0
    for row, finished in _measured(units, campaign, setting):
        _show(row)
        failed += not finished
        if finished:
            campaign.add(row)
        if not arguments.quick:
            _write_document([row])
    if not failed:
        campaign.close([unit.key for unit in units])
    return cli.EXIT_BAD_INPUT if failed else 0


def _measured(units: Sequence[Unit], campaign: Campaign, setting: Setting) -> Iterator[tuple[Row, bool]]:
    for number, unit in enumerate(units, start=1):
        if unit.key in campaign:
            continue
        where = f" on {unit.clip}" if unit.clip else ""
        print(f"[{number}/{len(units)}] {unit.figure.area}: {unit.figure.title}{where}", file=sys.stderr)
        yield measure(unit, setting)


def _show(row: Row) -> None:
    verdict = {True: "holds", False: "DOES NOT HOLD", None: "-"}[row["holds"]]
    got = row["got"] if row["got"] is not None else row["note"]
    print(
        f"{row['area']}/{row['name']} {row['clip'] or ''}: {got}; asked {row['asked']}: {verdict}", flush=True
    )


if __name__ == "__main__":
    sys.exit(main())
