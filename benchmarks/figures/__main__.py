"""Measure the figures that are asked of the project, and write `docs/figures.json` and `docs/figures.md`.

A run that was interrupted goes on where it stopped; once it is through, the next run measures everything
again. With ``--quick`` the measurements are only tried out, and nothing is written to `docs`.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.figures.definitions import Unit, selected_units, with_frames
from benchmarks.figures.document import is_failure, read_rows, row_key, write_document, write_rows
from benchmarks.figures.harness import RESULTS, Key, MissingClip, Row, Setting, today
from benchmarks.figures.origin import machine
from dvc import cli
from dvc.errors import DvcError

PROG = "python -m benchmarks.figures"
EXAMPLES = """\
  python -m benchmarks.figures                        all figures; hours
  python -m benchmarks.figures --area turbo           those of one area
  python -m benchmarks.figures --area rd --clip box   one sequence
  python -m benchmarks.figures --quick                try every measurement out; minutes
  python -m benchmarks.figures --list                 what there is
  python -m benchmarks.figures --page                 docs/figures.md again, after changes of the code
"""


def measure(unit: Unit, setting: Setting) -> tuple[Row, bool]:
    """Measure one row."""
    made_by = {"code": None if setting.any_version else unit.digest, "machine": machine()}
    try:
        row = unit.figure.row(unit.clip, unit.figure.measure(setting, unit.clip or ""))
    except MissingClip as err:
        return unit.figure.row(unit.clip, None, str(err)), True
    except (DvcError, OSError) as err:
        reason = cli.one_line(err)
    except Exception as err:  # whatever it is, what was measured before is not shown any more
        reason = f"{type(err).__name__}: {cli.one_line(err)}"
    else:
        return with_frames(row, setting.frames) | made_by, True
    failure = {"holds": False, "date": today(), "note": f"the measurement failed: {reason}"}
    return unit.figure.row(unit.clip, None) | failure | made_by, False


class Campaign:
    """Rows that were measured since the last complete run, in a file, so that an interrupted run goes on."""

    def __init__(self, path: Path, frames: int) -> None:
        self._path = path
        self._rows: dict[Key, Row] = {}
        self._frames = frames
        for row in read_rows(path):
            if row.get("frames") == frames:
                self._rows[row_key(row)] = row

    def __contains__(self, unit: Unit) -> bool:
        """Tell whether a row is done, by the code as it is now."""
        row = self._rows.get(unit.key)
        return row is not None and row["code"] in {None, unit.digest}

    def add(self, row: Row) -> None:
        """Enter a row that is done."""
        self._rows[row_key(row)] = row | {"frames": self._frames}
        write_rows(self._path, list(self._rows.values()))

    def close(self, keys: Sequence[Key]) -> None:
        """Forget rows, because all that were to be measured are."""
        self._rows = {key: row for key, row in self._rows.items() if key not in keys}
        write_rows(self._path, list(self._rows.values()))


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
    parser.add_argument(
        "--points",
        type=Path,
        action="append",
        default=[],
        metavar="DIR",
        help="read points from results of dvc-rd; can be repeated",
    )
    parser.add_argument("--again", action="store_true", help="forget what an interrupted run has measured")
    parser.add_argument("--list", action="store_true", help="list the figures")
    parser.add_argument(
        "--page", action="store_true", help="measure nothing; show which rows are stale in docs/figures.md"
    )
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command."""
    arguments = _parser().parse_args(argv)
    return cli.run(PROG, lambda: _run(arguments))


def _run(arguments: argparse.Namespace) -> int:
    if arguments.page:
        write_document([])
        return 0
    units = selected_units(arguments.area, arguments.name, arguments.clip, arguments.quick)
    if arguments.list:
        for unit in units:
            print(f"{unit.figure.area:12}{unit.figure.name:28}{unit.clip or '':18}{unit.figure.asked}")
        return 0
    folder = RESULTS / "quick" if arguments.quick else RESULTS
    setting = Setting(
        arguments.quick,
        arguments.frames,
        arguments.jobs,
        folder,
        arguments.any_version,
        tuple(arguments.points),
    )
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
            write_document([row])
    if not failed:
        campaign.close([unit.key for unit in units])
    return cli.EXIT_BAD_INPUT if failed else 0


def _measured(units: Sequence[Unit], campaign: Campaign, setting: Setting) -> Iterator[tuple[Row, bool]]:
    for number, unit in enumerate(units, start=1):
        if unit in campaign:
            continue
        where = f" on {unit.clip}" if unit.clip else ""
        print(f"[{number}/{len(units)}] {unit.figure.area}: {unit.figure.title}{where}", file=sys.stderr)
        yield measure(unit, setting)


def _show(row: Row) -> None:
    verdict = {True: "holds", False: "DOES NOT HOLD", None: "-"}[row["holds"]]
    verdict = "FAILED" if is_failure(row) else verdict
    got = row["got"] if row["got"] is not None else row["note"]
    print(
        f"{row['area']}/{row['name']} {row['clip'] or ''}: {got}; asked {row['asked']}: {verdict}", flush=True
    )


if __name__ == "__main__":
    sys.exit(main())
