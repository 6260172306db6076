"""Hostile input: mutate streams and live messages, and watch for crashes, hangs, tracebacks and allocations.

Mutations run in child processes, a batch at a time, so that a crash or a hang is counted and does not end
the run. Every mutation has a number, which is its seed: ``--kind KIND --first NUMBER --count 1`` repeats it.
What did harm is written to a folder by ``--finds``; from `tests/golden/finds` a test tries it again.
"""

import argparse
import json
import secrets
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.hostile.attempts import kinds
from benchmarks.hostile.batches import GOOD, KINDS, run_batch, run_kind, summary
from benchmarks.hostile.bounds import show_bounds
from dvc import cli

PROG = "python -m benchmarks.hostile"
EXAMPLES = """\
  python -m benchmarks.hostile                               5,000 mutations of each kind
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
        "--count", type=cli.integer(1, 10**7), default=5000, metavar="N", help="of each kind; default: 5000"
    )
    parser.add_argument("--finds", type=Path, metavar="FOLDER", help="write there what did harm")
    parser.add_argument("--bounds", action="store_true", help="first show that indices are checked")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.child:
        numbers = range(arguments.first, arguments.first + arguments.count)
        json.dump(run_batch(arguments.kind[0], numbers), sys.stdout)
        return 0
    return cli.run(PROG, lambda: _run(arguments))


def _run(arguments: argparse.Namespace) -> int:
    if arguments.bounds:
        print(show_bounds())
    if arguments.random:
        arguments.first = secrets.randbelow(_MOST)
        print(f"--first {arguments.first}")
    harmful = 0
    chosen = arguments.kind or KINDS
    with cli.progress_bar("mutations", arguments.count * len(chosen)) as progress:
        for kind in chosen:
            counts, failures = summary(run_kind(kind, arguments.first, arguments.count, progress))
            good = (f"{count} {text}" for text, count in counts.most_common() if text in GOOD)
            print(f"{kind}: " + ", ".join(good), flush=True)
            for number, text in failures.items():
                print(f"  {number}: {text}", flush=True)
                if arguments.finds is not None:
                    _save(arguments.finds / kind, number, kinds()[kind].damaged(number))
            harmful += len(failures)
    return cli.EXIT_BAD_INPUT if harmful else 0


def _save(folder: Path, number: int, damaged: bytes) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{number}.bin").write_bytes(damaged)


if __name__ == "__main__":
    sys.exit(main())
