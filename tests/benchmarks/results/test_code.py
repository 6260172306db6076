"""Identity of the code of a result."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.results.code import ROOT, own_code, tree_hash


def _git(folder: Path, *words: str) -> str:
    identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
    done = subprocess.run(
        ["git", "-C", folder, *identity, *words], capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def test_trees_are_hashed_as_git_does(tmp_path: Path) -> None:
    package = tmp_path / "sfm"
    shutil.copytree(ROOT / "sfm", package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "a.b").mkdir()
    (package / "a.b" / "run").write_text("1")
    (package / "a.b" / "run").chmod(0o755)
    (package / "a-file").write_text("2")
    _git(tmp_path, "init", "-q")
    _git(tmp_path, "add", "-A")
    _git(tmp_path, "commit", "-qm", "x")
    (package / "__pycache__").mkdir()
    (package / "__pycache__" / "x.pyc").write_bytes(b"3")
    assert tree_hash(package) == _git(tmp_path, "rev-parse", "HEAD:sfm")
    (package / "a-file").write_text("4")
    assert tree_hash(package) != _git(tmp_path, "rev-parse", "HEAD:sfm")


def test_own_code_is_what_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Comments, docstrings and layout do not change the digest of a module; code does."""
    monkeypatch.syspath_prepend(tmp_path)
    found = []
    for text in (
        "def f(x):\n    return x + 1\n",
        '"""A."""\n# b\ndef f(x):\n    """C."""\n    return (x\n + 1)\n',
    ):
        (tmp_path / "a_made_up_module.py").write_text(text)
        if "a_made_up_module" not in sys.modules:
            __import__("a_made_up_module")
        found.append(own_code("a_made_up_module"))
    (tmp_path / "a_made_up_module.py").write_text("def f(x):\n    return x + 2\n")
    changed = own_code("a_made_up_module")
    del sys.modules["a_made_up_module"]
    assert found[0] == found[1] != changed
