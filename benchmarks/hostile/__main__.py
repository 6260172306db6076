"""Hostile input: mutate streams and live messages, and watch for crashes, hangs, tracebacks and allocations.

Mutations run in child processes, so that a crash or a hang is counted and does not end the run. Every
mutation has a number, which is its seed: ``--kind KIND --first NUMBER --count 1`` repeats it. What did harm
is written to a folder by ``--finds``; what lies in `tests/golden/finds` is tried by a test.
"""

import argparse
import secrets
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.hostile.attempts import kinds
from benchmarks.hostile.batches import GOOD, KINDS, run_batch, run_kind, stop, summary
from dvc import cli

PROG = "python -m benchmarks.hostile"
EXAMPLES = """\
  python -m benchmarks.hostile                               3,000 mutations of each kind
  python -m benchmarks.hostile --count 200 --random          others at each run
  python -m benchmarks.hostile --kind buffered --first 4711 --count 1   one mutation again
"""
_MOST = 10**9


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = cli.ArgumentParser(PROG, "Mutate streams and live messages.", EXAMPLES)
    parser.add_argument("--kind", choices=KINDS, action="append", help="default: all")
    parser.add_argument("--first", type=cli.integer(0, 2 * _MOST), default=0, metavar="N", help="default: 0")
    parser.add_argument("--random", action="store_true", help="begin at a number that is drawn, and say it")
    parser.add_argument(
        "--count", type=cli.integer(1, 10**7), default=3000, metavar="N", help="of each kind; default: 3000"
    )
    parser.add_argument("--jobs", type=cli.integer(1, 64), default=1, help="kinds at a time; default: 1")
    parser.add_argument("--finds", type=Path, metavar="FOLDER", help="write there what did harm")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.child:
        for outcome in run_batch(arguments.kind[0], _numbers(arguments)):
            print(outcome, flush=True)
        return 0
    return cli.run(PROG, lambda: _run(arguments))


def _numbers(arguments: argparse.Namespace) -> range:
    return range(arguments.first, arguments.first + arguments.count)


def _run(arguments: argparse.Namespace) -> int:
    if arguments.random:
        arguments.first = secrets.randbelow(_MOST)
        print(f"--first {arguments.first}")
    harmful, chosen = 0, arguments.kind or KINDS
    with (
        cli.progress_bar("mutations", arguments.count * len(chosen)) as progress,
        ThreadPoolExecutor(arguments.jobs) as pool,
    ):
        work = [pool.submit(run_kind, kind, arguments.first, arguments.count, progress) for kind in chosen]
        try:
            for kind, outcomes in zip(chosen, work, strict=True):
                harmful += _tell(kind, outcomes.result(), arguments.finds)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            stop()
    return cli.EXIT_BAD_INPUT if harmful else 0


def _tell(kind: str, outcomes: dict[int, str], finds: Path | None) -> int:
    """Print outcomes, and keep what did harm; return how many did."""
    counts, failures = summary(outcomes)
    good = (f"{count} {text}" for text, count in counts.most_common() if text in GOOD)
    print(f"{kind}: " + ", ".join(good), flush=True)
    for number, text in failures.items():
        print(f"  {number}: {text}", flush=True)
        if finds is not None:
            (finds / kind).mkdir(parents=True, exist_ok=True)
            (finds / kind / f"{number}.bin").write_bytes(kinds()[kind].damaged(number))
    return len(failures)


if __name__ == "__main__":
    sys.exit(main())
