"""Origin of results: the commit of the code, and whether the code was changed since."""

import subprocess
from pathlib import Path

import pytest

from dvc.rd.originals import _commit


def _git(folder: Path, *command: str) -> None:
    who = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    subprocess.run(["git", "-C", str(folder), *who, *command], check=True, capture_output=True)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    source = tmp_path / "dvc" / "__init__.py"
    source.parent.mkdir()
    source.write_text("")
    (tmp_path / "notes.md").write_text("")
    _git(tmp_path, "init")
    _git(tmp_path, "add", ".")
    _git(tmp_path, "commit", "-m", "first")
    return source


def test_documents_leave_the_code_clean(source: Path) -> None:
    clean = _commit(source)
    (source.parents[1] / "notes.md").write_text("changed")
    assert clean is not None
    assert len(clean) == 12
    assert _commit(source) == clean


def test_changed_code_is_dirty(source: Path) -> None:
    """A changed source file, or a new one, makes the commit dirty."""
    clean = _commit(source)
    (source.parent / "new.py").write_text("")
    assert _commit(source) == f"{clean}-dirty"


def test_no_repository_has_no_commit(source: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    other = source.parent / "other.py"
    other.write_text("")
    assert _commit(other) is None
    untracked = tmp_path_factory.mktemp("untracked") / "__init__.py"
    untracked.write_text("")
    assert _commit(untracked) is None
