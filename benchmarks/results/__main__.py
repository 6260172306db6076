"""Command ``python -m benchmarks.results``: measure, check, show."""

import argparse
import sys
import time
from pathlib import Path

from benchmarks.results import document, fill, plot
from benchmarks.results.code import code_digest, write_constraints
from benchmarks.results.harness import FOLDER, Missing, Setting
from benchmarks.results.rows import BY_NAME, ROWS, Row
from dvc import cli
from dvc.errors import DvcError

PROG = "python -m benchmarks.results"
EXAMPLES = """\
  python -m benchmarks.results                          all results that are not of this code (make results)
  python -m benchmarks.results --row rate/x264-medium   one of them
  python -m benchmarks.results --quick --row decoding/time   whether it can be measured; nothing is kept
  python -m benchmarks.results --check                  which are those of this code, by canaries
  python -m benchmarks.results --fill                   page, plot and numbers in documents again
"""


def _parser() -> argparse.ArgumentParser:
    parser = cli.ArgumentParser(PROG, "Measure the headline results, and show them.", EXAMPLES)
    add = parser.add_argument
    add("--row", action="append", metavar="NAME", choices=BY_NAME, help="repeatable; default: all")
    add("--again", action="store_true", help="repeat results of this code, too")
    add("--quick", action="store_true", help="few clips and frames, to try it out; nothing is kept")
    add("--jobs", type=cli.integer(1, 64), default=2, metavar="N", help="points at a time; default: 2")
    add("--folder", type=Path, default=FOLDER, help=f"intermediate results; default: {FOLDER}")
    only = parser.add_mutually_exclusive_group()
    only.add_argument("--list", action="store_true", help="list the results")
    only.add_argument(
        "--check", action="store_true", help="list which are those of this code; status 1 if not all"
    )
    only.add_argument("--fill", action="store_true", help="write the page, the plot and numbers in documents")
    return parser


def _run(arguments: argparse.Namespace) -> int:
    rows = [row for row in ROWS if arguments.row is None or row.name in arguments.row]
    if arguments.list:
        for row in rows:
            print(f"{row.name:28} {row.target:>12}  {row.title}")
        return 0
    if arguments.check:
        return _check(rows)
    if arguments.fill:
        show()
        return 0
    setting = Setting(
        arguments.quick, arguments.jobs, arguments.folder / ("quick" if arguments.quick else "")
    )
    return _measure(rows, setting, again=arguments.again)


def _check(rows: list[Row]) -> int:
    entries, all_hold = document.read_document(), True
    for row in rows:
        entry = entries.get(row.name)
        if entry is None:
            state = "absent"
        elif document.is_current(entry, row):
            state = "measured with this code"
        else:
            state = "fresh: the same bytes" if document.still_holds(entry, row) else "stale"
        all_hold &= state not in ("absent", "stale")
        print(f"{row.name:28} {state}", flush=True)
    return 0 if all_hold else 1


def _measure(rows: list[Row], setting: Setting, *, again: bool) -> int:
    """Measure rows, write each result at once, and continue if one fails."""
    entries = {} if setting.quick else document.kept(document.read_document())
    failures = 0
    for row in rows:
        if row.name in entries and not again:
            continue
        digest, started = code_digest(), time.perf_counter()
        try:
            measured = row.measure(setting)
        except Missing as err:
            print(f"{row.name}: {err}", file=sys.stderr, flush=True)
            continue
        except DvcError as err:
            failures += 1
            print(f"{row.name}: failed: {err}", file=sys.stderr, flush=True)
            continue
        wall_s = time.perf_counter() - started
        print(f"{row.name}: {row.written(measured.value)} (target {row.target}), {wall_s:.0f} s", flush=True)
        code_digest.cache_clear()
        if code_digest() != digest:
            raise DvcError("the code was changed while it was measured")
        if not setting.quick:
            entries[row.name] = document.entry_of(row, measured, wall_s)
            document.write_document(entries)
            write_constraints()
    if not setting.quick:
        show(setting)
    return cli.EXIT_BAD_INPUT if failures else 0


def show(setting: Setting | None = None) -> None:
    """Write the page and the numbers in documents, and the plot if its curves exist."""
    entries = document.read_document()
    document.PAGE.write_text(document.page_text(entries), encoding="utf-8")
    changed = fill.fill(entries)
    if plot.draw(setting or Setting()):
        changed.append(plot.PLOT)
    for path in [document.PAGE, *changed]:
        print(path)


main = cli.command(PROG, _parser, _run)

if __name__ == "__main__":
    sys.exit(main())
