"""Figures of the house: what is a line of code, which arrows run upward, how revisions are compared."""

import subprocess
from pathlib import Path

import pytest

from benchmarks.figures.harness import Setting, Usage
from benchmarks.figures.house import golden, revisions, times
from benchmarks.figures.house.sources import Packages, Source, entries, reason
from dvc.errors import DvcError

TEXT = '''"""A module."""

# A comment.
import os


def f(x: int) -> str:
    """Do.

    Nothing.
    """
    table = """
    one
    """  # three lines of code

    def inner() -> int:
        return x

    return table + str(inner())


LIMIT = 3
"""What is documented so is no code."""
'''


def test_lines_of_code_are_counted() -> None:
    """Comments, docstrings and blank lines are no code; strings that are used are."""
    assert sorted(Source("a.py", TEXT).code_lines()) == [4, 7, 12, 13, 14, 16, 17, 19, 22]


def test_functions_are_measured() -> None:
    """A function has the lines of code from its `def`, and so has one within it."""
    assert dict(Source("a.py", TEXT).functions()) == {"a.py:7 f": 7, "a.py:16 inner": 2}


def test_arrows_run_upward() -> None:
    """Imports of what lies above are found, in functions too; those of what lies below are not."""
    found = (
        Source("dvc/rd/sources.py", "import sequences.catalogue\nfrom dvc import rd"),
        Source("dvc/__init__.py", "def f():\n    from dvc import rd"),
        Source("sfm/model.py", "from dvc.multiview import cameras"),
        Source("encoder/session.py", "from dvc import multiview, stream\nimport dvcx, sfmx"),
        Source("decoder/session.py", "from sfm.pipeline import reconstruct"),
    )
    assert Packages(found).upward_imports() == [
        "dvc.rd.sources -> sequences",
        "dvc -> dvc.rd",
        "encoder.session -> dvc.multiview",
    ]


def test_long_sources_are_found() -> None:
    """A function above the limit of code is too long, and so is a file above that of lines; comments tell."""
    comments, code = "    # A reason.\n" * 400, "    x = 1\n" * 40
    packages = Packages(
        (Source("dvc/a.py", f"def f():\n{code}"), Source("dvc/b.py", f"def f():\n{comments}    x = 1"))
    )
    assert packages.long_functions() == {"dvc/a.py:1 f": 41}
    assert packages.long_files() == {"dvc/b.py": 401}
    assert packages.num_code_lines() == 43


def test_kernels_have_a_reason_to_be_long() -> None:
    """Compiled loops share a file; others are to say why they are long."""
    assert reason("dvc/slepian_wolf/turbo/_kernels.py")
    assert reason("dvc/slepian_wolf/nowhere.py") is None


def test_private_modules_are_no_entries(tmp_path: Path) -> None:
    """A newcomer sees modules and packages, not kernels, caches and data."""
    for name in ("__init__.py", "_kernels.py", "protocol.py", "notes.txt"):
        (tmp_path / name).touch()
    for name in ("scene", "__pycache__"):
        (tmp_path / name).mkdir()
    assert entries(tmp_path) == ["protocol.py", "scene"]


def test_unknown_revision_is_refused() -> None:
    """A revision that is not there is named."""
    with (
        pytest.raises(DvcError, match="no revision 0123456 to compare with"),
        revisions.base_tree("0123456789"),
    ):
        pass


def test_revisions_run_what_they_have() -> None:
    """A module that runs in a checkout comes from there, not from the working tree."""
    known = ["git", "-C", str(revisions.TREE), "cat-file", "-e", revisions.BASE]
    if subprocess.run(known, check=False, capture_output=True).returncode != 0:
        pytest.skip("no git, or no such revision")
    with revisions.base_tree() as tree:
        (tree / "encoder" / "told.py").write_text("import dvc, sys; sys.exit(dvc.__file__ != sys.argv[1])")
        revisions.run_in(tree, "encoder.told", [tree / "dvc" / "__init__.py"])


def test_ratio_is_of_runs_in_turn() -> None:
    """The old revision runs first and last, and the ratio of the medians is judged."""
    order, base = [], Path("base")

    def run(tree: Path) -> Usage:
        order.append(tree)
        return Usage(wall_s=2.0 if tree == base else 1.0, cpu_s=4.0 if tree == base else 4.4, peak_bytes=0)

    measured = times.ratio(run, base, 2, 1.0, "wall_s")
    assert order == [base, revisions.TREE, base, revisions.TREE, base]
    assert (measured.got, measured.holds) == ("0.50 (2.0 → 1.0 s)", True)
    assert not times.ratio(run, base, 1, 1.0, "cpu_s").holds


@pytest.mark.parametrize(
    ("status", "said", "got", "holds"),
    [
        (0, "....\n4 passed in 2s\n", "4 of 4 tests pass", True),
        (1, "FAILED tests/a.py::test_b[x-y] - E\n1 failed, 3 passed in 2s\n", "3 of 4 tests pass", False),
    ],
)
def test_frozen_streams_are_counted(
    monkeypatch: pytest.MonkeyPatch, status: int, said: str, got: str, holds: bool
) -> None:
    """A row holds if all tests pass, and names those that do not."""
    monkeypatch.setattr(
        golden.subprocess, "run", lambda *a, **_: subprocess.CompletedProcess(a, status, said)
    )
    measured = golden.frozen_streams(Setting(), "", {})
    assert (measured.got, measured.holds) == (got, holds)
    assert measured.values["failures"] == ([] if holds else ["x-y"])


def test_tests_that_do_not_run_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests that cannot be collected are no measurement."""
    monkeypatch.setattr(
        golden.subprocess, "run", lambda *a, **_: subprocess.CompletedProcess(a, 4, "no file")
    )
    with pytest.raises(DvcError, match="status 4: no file"):
        golden.frozen_streams(Setting(), "", {})
