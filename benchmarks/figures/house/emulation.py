"""Frozen streams decoded by a processor that QEMU emulates: other features than this one's, for real."""

import json
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.house.revisions import TREE
from dvc.errors import DvcError

STREAMS = TREE / "tests" / "golden" / "streams"
DECODED = ("2d-colour", "3d-fused", "3d-td-all", "3d-te-mesh", "3d-te-odd")
PROCESSORS = ("Nehalem", "max")
"""The least processor that the libraries' wheels run on, and all that QEMU knows: AVX2, but not AVX-512."""
_PROGRAM = """
import hashlib, sys
from pathlib import Path
import decoder.__main__ as decoder
sys.executable = sys.argv[1]
for path in sys.argv[3:]:
    status = decoder.main([path, sys.argv[2], "--quiet"])
    print(status or hashlib.sha256(Path(sys.argv[2]).read_bytes()).hexdigest())
"""


def emulated_streams(setting: Setting, _clip: str) -> Measured:
    """Decode punctured streams in processes under `qemu-x86_64` (Debian's package qemu-user)."""
    emulator = shutil.which("qemu-x86_64")
    if emulator is None:
        raise DvcError("no qemu-x86_64: install Debian's package qemu-user")
    paths = [STREAMS / f"{name}-punctured.dvc" for name in DECODED[-1 if setting.quick else 0 :]]
    records = json.loads((STREAMS / "records.json").read_text())
    frozen = [records[path.name]["video_sha256"] for path in paths]
    with tempfile.TemporaryDirectory() as folder:
        _digests(Path(folder), "", paths)  # compiles, so that the emulator need not
        found = {name: _digests(Path(folder), f"{emulator} -cpu {name} ", paths) for name in PROCESSORS}
    same = sum(
        ours == theirs for digests in found.values() for ours, theirs in zip(digests, frozen, strict=True)
    )
    total = len(frozen) * len(found)
    return Measured(
        f"{same} of {total} streams decode to the frozen frames", same == total, {"digests": found}
    )


def _digests(folder: Path, emulator: str, paths: list[Path]) -> list[str]:
    """Decode streams in processes that an emulator runs; return the digests of the videos."""
    interpreter = folder / "python"
    interpreter.write_text(f'#!/bin/sh\nexec {emulator}{os.path.realpath(sys.executable)} "$@"\n')
    interpreter.chmod(interpreter.stat().st_mode | stat.S_IXUSR)
    compiled = {
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
        "NUMBA_CACHE_DIR": str(folder / "cache"),
    }
    variables = os.environ | compiled | {"PYTHONPATH": os.pathsep.join([str(TREE), *sys.path])}
    command = [sys.executable, "-c", _PROGRAM, *map(str, (interpreter, folder / "video.y4m", *paths))]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=TREE, env=variables)
    if done.returncode != 0:
        raise DvcError(f"decoding failed: {done.stderr.strip()[-300:]}")
    return done.stdout.split()


FIGURES = (
    Figure(
        "house",
        "golden-qemu",
        "punctured streams of every codec on processors that QEMU emulates (Nehalem; with AVX2)",
        "all decode to the frozen frames",
        emulated_streams,
        slow=True,
        programs=("decoder",),
    ),
)
"""Figures of this module."""
