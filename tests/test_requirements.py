"""What the package needs: wheels for every Python, the newest and those that results were measured with."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from benchmarks.results.code import CONSTRAINTS, write_constraints

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OF_USERS = ("dask", "decode", "mesh", "report", "stereo")
NEEDED = [
    *PROJECT["dependencies"],
    *(line for name in OF_USERS for line in PROJECT["optional-dependencies"][name]),
]
PYTHONS = ("3.11", "3.12", "3.13")


def names(lines: list[str]) -> set[str]:
    """Return the names of packages."""
    return {re.split(r"[=>\[ ]", line)[0] for line in lines}


def test_constraints_hold_all_that_results_rest_on(tmp_path: Path) -> None:
    write_constraints(tmp_path / "new.txt")
    for path in (CONSTRAINTS, tmp_path / "new.txt"):
        lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
        assert all(re.fullmatch(r"[a-z0-9-]+==[\w.]+", line) for line in lines)
        assert names(NEEDED) | {"llvmlite"} <= names(lines)
        assert len(names(lines)) == len(lines)
        assert not names(lines) & {"dvc3d", "pytest", "ruff", "sphinx"}


def test_all_extras_of_users_are_in_one() -> None:
    assert PROJECT["optional-dependencies"]["all"] == [f"dvc3d[{','.join(OF_USERS)}]"]


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("constrained", [False, True], ids=["newest", "of the results"])
@pytest.mark.parametrize("python", PYTHONS)
def test_all_is_there_as_wheels(python: str, constrained: bool, tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--dry-run",
        "--ignore-installed",
        "--quiet",
        "--report",
        "-",
    ]
    command += ["--target", str(tmp_path), "--python-version", python, "--only-binary=:all:"]
    done = subprocess.run(
        [*command, *(["--constraint", str(CONSTRAINTS)] if constrained else []), *NEEDED],
        capture_output=True,
        text=True,
        check=False,
    )
    if "No matching distribution found for" not in done.stderr and re.search(
        r"connection|retr", done.stderr, re.I
    ):
        pytest.skip("there is no package index")
    assert done.returncode == 0, done.stderr
    found = [
        entry["metadata"]["name"].lower().replace("_", "-") for entry in json.loads(done.stdout)["install"]
    ]
    assert names(NEEDED) <= set(found)
