"""Compiled kernels are kept from one clone to the next."""

import os
from pathlib import Path

import pytest

from tests import kernels


def test_kernels_are_kept_and_fetched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was compiled lately comes into a clone that has none; into another nothing comes."""
    monkeypatch.setenv("DVC_KERNELS", str(tmp_path / "kept"))
    made, bare, other = (tmp_path / name / "dvc" / "__pycache__" for name in ("made", "bare", "other"))
    for folder in (made, bare, other):
        folder.mkdir(parents=True)
    for name, age_s in (("new.nbi", 0), ("new.1.nbc", 0), ("old.nbi", 2 * kernels.MAX_AGE_S)):
        (made / name).write_text(name)
        os.utime(made / name, times=(0, (made / name).stat().st_mtime - age_s))
    (made / "module.pyc").touch()
    (other / "own.nbi").touch()
    monkeypatch.setattr(kernels, "ROOT", tmp_path / "made")
    kernels.keep()
    for root in ("bare", "other"):
        monkeypatch.setattr(kernels, "ROOT", tmp_path / root)
        kernels.fetch()
    assert {path.name: path.read_text() for path in bare.iterdir()} == {
        "new.nbi": "new.nbi",
        "new.1.nbc": "new.1.nbc",
    }
    assert [path.name for path in other.iterdir()] == ["own.nbi"]
