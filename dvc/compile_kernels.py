"""Command ``dvc-compile``: compile what programs call, and leave the code beside its sources.

A wheel is built with it, so that an installed program compiles nothing; where numba or the processor is one
that this code is not for, the command, or else each program, compiles once more.

`DVC_REGENERATE=1`, for `tests/test_compile_kernels.py`, adds to `kernels.txt` what programs call.
"""

import argparse
import importlib
import os
import sys
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

from dvc import cli
from dvc.environment import baseline_environment
from dvc.extras import of_an_extra

PROG = "dvc-compile"
KERNELS = Path(__file__).with_name("kernels.txt")
EXAMPLES = """\
  dvc-compile
  dvc-compile --jobs 4
"""


class Kernel(NamedTuple):
    """A line of the list: what is called from Python, and the types of its arguments."""

    module: str  # where it is
    name: str
    signature: str  # see `dvc._jit.compile_for`

    def compile(self) -> None:
        """Compile it, unless it is on disk, or for commands that are not installed."""
        from dvc._jit import compile_for

        try:
            module = importlib.import_module(self.module)
        except ModuleNotFoundError as err:
            if not of_an_extra(err.name):
                raise
            return
        compile_for(getattr(module, self.name), self.signature)


def listed() -> list[Kernel]:
    """Read the list."""
    return [Kernel(*line.split(" ", 2)) for line in KERNELS.read_text(encoding="utf-8").splitlines()]


def _parser() -> argparse.ArgumentParser:
    text = (
        "Compile what the programs call, where it was not compiled yet, for all users of this installation."
    )
    parser = cli.ArgumentParser(PROG, text, EXAMPLES)
    jobs = "processes that compile at the same time"
    cli.add_integer(parser, "--jobs", (1, 256), jobs, default=len(os.sched_getaffinity(0)))
    return parser


def _compile(arguments: argparse.Namespace) -> int:
    from dvc._jit import PORTABLE, RUNS_PORTABLE

    os.environ |= baseline_environment()
    if RUNS_PORTABLE:
        os.environ |= dict(zip(("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"), PORTABLE, strict=True))
    kernels = listed()
    with (
        get_context("spawn").Pool(arguments.jobs) as pool,
        cli.progress_bar("compiling", len(kernels)) as done,
    ):
        for _ in pool.imap_unordered(Kernel.compile, kernels):
            done(1)
    return 0


main = cli.command(PROG, _parser, _compile)

if __name__ == "__main__":
    sys.exit(main())
