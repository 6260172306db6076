"""Where another package owns the import name ``dvc``, every command says so."""

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]


def run(script: str, first: Path) -> subprocess.CompletedProcess[str]:
    """Call an entry point as its script does, with a folder before the project on the path."""
    module, function = SCRIPTS[script].split(":")
    code = f"import sys; import {module}; sys.argv = [{script!r}, '--help']; sys.exit({module}.{function}())"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(first), str(ROOT)])}
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=first,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("script", SCRIPTS)
def test_foreign_package_is_told(script: str, tmp_path: Path) -> None:
    """With Data Version Control's `dvc` imported, a command is one line and status 2."""
    (tmp_path / "dvc" / "cli").mkdir(parents=True)
    for file in ("__init__.py", "cli/__init__.py"):
        (tmp_path / "dvc" / file).write_text("")
    done = run(script, tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith(f"{script}: ")
    assert str(tmp_path / "dvc") in done.stderr
    assert "Data Version Control" in done.stderr


def test_packages_mixed_in_one_folder_are_told(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "dvc", tmp_path / "dvc", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "dvc" / "cli").mkdir()
    (tmp_path / "dvc" / "cli" / "__init__.py").write_text("")
    assert run("dvc-encode", tmp_path).returncode == 2


@pytest.mark.parametrize("script", SCRIPTS)
def test_commands_start(script: str, tmp_path: Path) -> None:
    done = run(script, tmp_path)
    assert done.returncode == 0
    assert done.stdout.startswith(f"usage: {script} ")
