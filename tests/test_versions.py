"""Identity of the code: an edit of the codec changes it, an edit of an experiment does not."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from dvc.versions import CODEC, NOT_OF_THE_CODEC

ROOT = Path(__file__).resolve().parents[1]
DIGEST = "from dvc.versions import codec_digest; print(codec_digest())"


def digest(folder: Path) -> str:
    """Return the digest of a copy of the packages."""
    command = [sys.executable, "-P", "-c", f"import sys; sys.path.insert(0, {str(folder)!r}); {DIGEST}"]
    return subprocess.run(command, check=True, capture_output=True, text=True, env={}).stdout


@pytest.mark.parametrize(
    ("file", "counts"),
    [
        ("dvc/video/frames.py", True),
        ("sfm/pipeline.py", True),
        ("decoder/__init__.py", True),
        ("dvc/rd/__init__.py", False),
        ("dvc/stereo/__init__.py", False),
    ],
)
def test_edits(file: str, counts: bool, tmp_path: Path) -> None:
    for package in CODEC:
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    before = digest(tmp_path)
    assert before == digest(ROOT)
    with (tmp_path / file).open("a") as source:
        source.write("CHANGED = 1\n")
    assert (digest(tmp_path) != before) == counts


def test_what_is_left_out_is_not_imported() -> None:
    """Import contracts forbid encoder and decoder the rooms that the digest leaves out."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    forbidden = [
        set(contract["forbidden_modules"])
        for contract in contracts
        if contract["type"] == "forbidden"
        and {"decoder", "encoder", "sfm"} <= set(contract["source_modules"])
    ]
    assert {f"dvc.{room}" for room in NOT_OF_THE_CODEC} in forbidden
