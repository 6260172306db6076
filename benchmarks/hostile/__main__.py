"""Hostile input: mutate streams and live messages, and watch for crashes, hangs, tracebacks and allocations.

Mutations run in child processes, so that a crash or a hang is counted and does not end the run. Every
mutation has a number, which is its seed: ``--kind KIND --first NUMBER --count 1`` repeats it. Inputs
that did harm are written to the folder ``--finds``; a test tries those of `tests/golden/finds`.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from benchmarks.hostile.batches import KINDS, run, run_batch, stop
from benchmarks.hostile.bounds import BOUNDS
from benchmarks.hostile.campaign import FIRST, FUZZING, Tried, fuzz, keep, print_outcomes
from dvc import cli

PROG = "python -m benchmarks.hostile"
EXAMPLES = """\
  python -m benchmarks.hostile                               3,000 mutations of each kind
  python -m benchmarks.hostile --hours 2      new ones for two hours under bounds checks
  python -m benchmarks.hostile --kind buffered --first 4711 --count 1   one mutation again
"""
_FEW = 100
"""Largest number of mutations of a kind that does not justify a process."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = cli.ArgumentParser(PROG, "Mutate streams and live messages.", EXAMPLES)
    parser.add_argument("--kind", choices=KINDS, action="append", help="default: all")
    parser.add_argument("--first", type=cli.integer(0, 3 * FIRST), default=0, metavar="N", help="default: 0")
    parser.add_argument("--hours", type=cli.parse_positive, metavar="H", help="try new mutations for H hours")
    parser.add_argument("--state", type=Path, default=FUZZING, help=f"of --hours; default: {FUZZING.name}")
    parser.add_argument(
        "--count", type=cli.integer(1, 10**7), default=3000, metavar="N", help="of each kind; default: 3000"
    )
    parser.add_argument("--jobs", type=cli.integer(1, 64), default=1, help="kinds at a time; default: 1")
    parser.add_argument("--finds", type=Path, metavar="FOLDER", help="folder for inputs that did harm")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.child:
        tries = [(kind, int(number)) for kind, number in map(str.split, sys.stdin)]
        for outcome in run_batch(tries):
            print(outcome, flush=True)
        return 0
    return cli.run(PROG, lambda: _run(arguments))


def _run(arguments: argparse.Namespace) -> int:
    harmful, chosen = 0, arguments.kind or KINDS
    if arguments.hours is not None:
        os.environ.setdefault(BOUNDS, "1")
        tried = Tried.read(arguments.state)
        harmful = fuzz(tried, chosen, arguments.hours, arguments.jobs, arguments.finds)
        return cli.EXIT_BAD_INPUT if harmful else 0
    num_parts = len(chosen) if arguments.count > _FEW else min(arguments.jobs, len(chosen))
    numbers = range(arguments.first, arguments.first + arguments.count)
    parts = [[(kind, n) for kind in chosen[k::num_parts] for n in numbers] for k in range(num_parts)]
    with (
        cli.progress_bar("mutations", arguments.count * len(chosen)) as progress,
        ThreadPoolExecutor(arguments.jobs) as pool,
    ):
        work = {pool.submit(run, part, progress): part for part in parts}
        try:
            for done in as_completed(work):
                bad = print_outcomes(work[done], done.result())
                keep(bad, arguments.finds)
                harmful += len(bad)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            stop()
            raise
    return cli.EXIT_BAD_INPUT if harmful else 0


if __name__ == "__main__":
    sys.exit(main())
