"""Command ``dvc-compile``: programs compile nothing afterwards."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dvc.cli import COMPILING
from dvc.compile_kernels import CHAINS, commands
from tests.golden_streams import GOLDEN

ROOT = Path(__file__).resolve().parents[1]


def run(environment: dict[str, str], folder: Path, *words: object) -> str:
    """Run a module; return what it writes on stderr."""
    command = [sys.executable, "-m", *map(str, words)]
    done = subprocess.run(command, env=environment, cwd=folder, capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stderr
    return done.stderr


def test_commands_are_of_all_programs() -> None:
    programs = {words[0] for chain in CHAINS for words in commands(chain)}
    assert programs == {"decoder", "dvc.dibr", "dvc.stereo", "encoder", "sequences", "sfm"}


def test_compilation_is_announced(tmp_path: Path) -> None:
    environment = os.environ | {
        "DVC_COMPILATION_NOTICE": "once",
        "NUMBA_CACHE_DIR": str(tmp_path / "kernels"),
        "NUMBA_DISABLE_JIT": "0",
        "PYTHONPATH": str(ROOT),
    }
    code = (
        "import sys; from dvc import cli\n"
        "def work(_):\n"
        "    from dvc.wynerziv._kernels import logarithm; logarithm(1.5); return 0\n"
        "def parser():\n"
        "    made = cli.ArgumentParser('dvc-try', ''); made.add_argument('--quiet', action='store_true')\n"
        "    return made\n"
        "sys.exit(cli.command('dvc-try', parser, work)(sys.argv[1:]))\n"
    )
    (tmp_path / "announced.py").write_text(code)
    environment["PYTHONPATH"] = os.pathsep.join([str(tmp_path), str(ROOT)])
    assert run(environment, tmp_path, "announced") == COMPILING.format("dvc-try") + "\n"
    assert run(environment, tmp_path, "announced") == ""
    environment["NUMBA_CACHE_DIR"] = str(tmp_path / "others")
    assert run(environment, tmp_path, "announced", "--quiet") == ""
    assert list((tmp_path / "others").rglob("*.nbc"))


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_programs_compile_nothing_afterwards(tmp_path: Path) -> None:
    cache = tmp_path / "kernels"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(ROOT)}
    run(environment, tmp_path, "dvc.compile_kernels")
    before = {path.name for path in cache.rglob("*.nbc")}
    for golden in GOLDEN:
        run(environment, tmp_path, "decoder", golden.path(golden.forms[0]), f"{golden.name}.y4m", "--quiet")
    assert {path.name for path in cache.rglob("*.nbc")} == before
