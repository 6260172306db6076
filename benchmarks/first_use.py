"""Time the first use of an installed wheel: `python -m benchmarks.first_use WHEEL [--out DIR]`.

The wheel is installed into an environment of its own with an empty home; dependencies are those of this
environment. README's first commands run there, one after the other, and compile their kernels.
"""

import argparse
import os
import subprocess
import sys
import sysconfig
import tempfile
import time
import venv
from collections.abc import Sequence
from pathlib import Path

from dvc.environment import python_module

RENDER = "dvc-sequences render street --size 176x144 --frames 9 --out street.mkv"
ENCODE = "dvc-encode street.mkv street.dvc --qp 30 --quiet"
DECODE = (
    "dvc-decode street.dvc decoded.mkv --reference street.mkv"
    " --json report.json --punctured small.dvc --quiet"
)


def main(argv: Sequence[str] | None = None) -> int:
    """Install, run, and print times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("wheel", type=Path, metavar="WHEEL")
    parser.add_argument("--out", type=Path, help="new folder for all of it (default: a temporary one)")
    arguments = parser.parse_args(argv)
    folder: Path = arguments.out or Path(tempfile.mkdtemp(prefix="first-use-"))
    _install(arguments.wheel.resolve(), folder)
    started = time.monotonic()
    for command in (RENDER, ENCODE):
        _run(command, folder)
    first_s = _run(DECODE, folder)
    total_s = time.monotonic() - started
    compiled = sum(1 for _ in folder.rglob("*.nbc"))
    print(f"all {total_s:.1f} s, first decoded frame {first_s:.1f} s after the decoder was started")
    size_mb = arguments.wheel.stat().st_size / 1e6
    print(f"wheel of {size_mb:.1f} MB, {compiled} kernels compiled")
    return 0


def _install(wheel: Path, folder: Path) -> None:
    """Install the wheel."""
    venv.create(folder / "venv")
    for name in ("home", "work"):
        (folder / name).mkdir()
    python = folder / "venv" / "bin" / "python"
    options = ["install", "--quiet", "--no-deps", "--no-index", "--disable-pip-version-check"]
    started = time.monotonic()
    subprocess.run(python_module("pip", "--python", python, *options, wheel), check=True)
    print(f"install {time.monotonic() - started:.1f} s")
    packages = next((folder / "venv").glob("lib/python*/site-packages"))
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib"))


def _run(command: str, folder: Path) -> float:
    """Run a command, and print its time; return the time of the first part of a decoded frame on the disk."""
    environment = {"PATH": f"{folder / 'venv' / 'bin'}:{os.defpath}", "HOME": str(folder / "home")}
    started, before, first_s = time.monotonic(), os.times(), 0.0
    with subprocess.Popen(command.split(), cwd=folder / "work", env=environment) as process:
        while process.poll() is None:
            time.sleep(0.02)
            files = (folder / "work").glob("*decoded*")
            if not first_s and any(file.stat().st_size > 1000 for file in files):
                first_s = time.monotonic() - started
    if process.returncode:
        raise SystemExit(f"{command}: exit status {process.returncode}")
    took_s, after = time.monotonic() - started, os.times()
    cpu_s = after.children_user + after.children_system - before.children_user - before.children_system
    print(f"{command.partition(' ')[0]} {took_s:.1f} s, {cpu_s:.1f} s of them processor time")
    return first_s or took_s


if __name__ == "__main__":
    sys.exit(main())
