"""Hostile input: mutate streams and live messages, and watch for crashes, hangs, tracebacks and allocations.

Mutations run in child processes, a batch at a time, so that a crash or a hang is counted and does not end
the run. Every mutation has a number, which is its seed: ``--kind KIND --first NUMBER --count 1`` repeats it.
"""

import argparse
import json
import sys
from collections.abc import Sequence

from benchmarks.hostile.batches import GOOD, KINDS, run_batch, run_kind, summary
from dvc import cli

PROG = "python -m benchmarks.hostile"
EXAMPLES = """\
  python -m benchmarks.hostile                               5,000 mutations of each kind
  python -m benchmarks.hostile --count 200                   a try
  python -m benchmarks.hostile --kind buffered --first 4711 --count 1   one mutation again
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = cli.ArgumentParser(PROG, "Mutate streams and live messages.", EXAMPLES)
    parser.add_argument("--kind", choices=KINDS, action="append", help="default: all")
    parser.add_argument("--first", type=cli.integer(0, 10**9), default=0, metavar="N", help="default: 0")
    parser.add_argument(
        "--count", type=cli.integer(1, 10**7), default=5000, metavar="N", help="of each kind; default: 5000"
    )
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.child:
        numbers = range(arguments.first, arguments.first + arguments.count)
        json.dump(run_batch(arguments.kind[0], numbers), sys.stdout)
        return 0
    return cli.run(PROG, lambda: _run(arguments))


def _run(arguments: argparse.Namespace) -> int:
    harmful = 0
    chosen = arguments.kind or KINDS
    with cli.progress_bar("mutations", arguments.count * len(chosen)) as progress:
        for kind in chosen:
            counts, failures = summary(run_kind(kind, arguments.first, arguments.count, progress))
            print(
                f"{kind}: "
                + ", ".join(f"{count} {text}" for text, count in counts.most_common() if text in GOOD)
            )
            for number, text in failures.items():
                print(f"  {number}: {text}")
            harmful += len(failures)
    return cli.EXIT_BAD_INPUT if harmful else 0


if __name__ == "__main__":
    sys.exit(main())
