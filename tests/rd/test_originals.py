"""Origin of results: the commit of the code, and whether the code was changed since."""

import subprocess
from pathlib import Path

from dvc.rd.originals import _commit


def _git(folder: Path, *command: str) -> None:
    who = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    subprocess.run(["git", "-C", str(folder), *who, *command], check=True, capture_output=True)


def test_only_changes_of_the_codec_make_a_commit_dirty(tmp_path: Path) -> None:
    source, notes = tmp_path / "code" / "dvc" / "__init__.py", tmp_path / "code" / "notes.md"
    source.parent.mkdir(parents=True)
    source.write_text("")
    notes.write_text("")
    assert _commit(source) is None
    for command in (["init"], ["add", "."], ["commit", "-m", "first"]):
        _git(notes.parent, *command)
    clean = _commit(source)
    assert clean is not None
    assert len(clean) == 12
    notes.write_text("changed")
    assert _commit(source) == clean
    other = source.with_name("other.py")
    other.write_text("")
    assert _commit(source) == f"{clean}-dirty"
    assert _commit(other) is None
