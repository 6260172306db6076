"""The revision that figures of the house compare with, and programs run as one revision has them."""

import os
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from benchmarks.figures.harness import Usage, run_module
from dvc.errors import DvcError

BASE = "6ca6294510724caa4f5f8c79bcd45233c7c34299"
"""The last revision before multi-view geometry and entropy coding had rooms of their own."""
TREE = Path(__file__).resolve().parents[3]
"""The working tree."""
PACKAGES = ("dvc", "encoder", "decoder", "sfm", "sequences")
PROGRAMS = ("encoder", "decoder", "sequences", "sfm", "dvc.rd", "dvc.dibr", "dvc.stereo")
"""All that can be run: what rows depend on that look at the whole code."""


@contextmanager
def base_tree(commit: str = BASE) -> Iterator[Path]:
    """Check a revision out into a temporary folder."""
    with tempfile.TemporaryDirectory() as scratch:
        archive = Path(scratch) / "base.tar"
        tree = Path(scratch) / "base"
        tree.mkdir()
        try:
            for command in (
                ["git", "-C", str(TREE), "archive", "--output", str(archive), commit],
                ["tar", "-x", "-f", str(archive), "-C", str(tree)],
            ):
                subprocess.run(command, check=True, capture_output=True, text=True)
        except FileNotFoundError as err:
            raise DvcError(f"comparing with revision {commit[:7]} needs the program {err.filename}") from err
        except subprocess.CalledProcessError as err:
            raise DvcError(f"no revision {commit[:7]} to compare with: {err.stderr.strip()}") from err
        archive.unlink()
        yield tree


def run_in(
    tree: Path, module: str, arguments: Sequence[object], environment: Mapping[str, str] | None = None
) -> Usage:
    """Run a module as a tree has it."""
    variables = {**os.environ, **(environment or {}), "PYTHONPATH": str(tree)}
    return run_module(module, arguments, folder=tree, environment=variables)
