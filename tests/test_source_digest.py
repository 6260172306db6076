"""Digests of code: what outdates a result, and what does not."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dvc import source_digest
from dvc.source_digest import Place, Sources
from dvc.versions import codec_digest

Edit = Callable[[str, str, str], None]
FILES = {
    "encoder/__init__.py": '"""A package."""\nfrom encoder.shapes import area\n',
    "encoder/shapes.py": "import math\nfrom encoder.numbers import TWO\ndef area(r): return math.pi*r**TWO\n",
    "encoder/numbers.py": "TWO = 2\nTHREE = 3\n",
    "encoder/__main__.py": "import encoder\n\n\ndef main():\n    print(encoder.area(1))\n\n\nmain()\n",
    "dvc/rd/__init__.py": "",
    "dvc/rd/run.py": 'import subprocess\n\n\ndef run():\n    subprocess.run(["encoder"])\n',
    "dvc/table.py": 'DATA = "table.json"\n',
    "dvc/table.json": "{}",
}
PROGRAM = [("encoder", "")]


def code_digest(places: list[Place]) -> str:
    return Sources().digest(places)


@pytest.fixture
def edit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Edit:
    """Write a small project, and return what replaces text in one of its files."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.setattr(source_digest, "_root", lambda: tmp_path)

    def replace(name: str, old: str, new: str) -> None:
        text = (tmp_path / name).read_text(encoding="utf-8") if (tmp_path / name).exists() else ""
        assert old in text
        (tmp_path / name).write_text(text.replace(old, new) if old else new, encoding="utf-8")

    return replace


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("encoder/shapes.py", "math.pi*r**TWO", "math.pi * r ** TWO  # of a disc"),
        ("encoder/shapes.py", "(r): return", '(r):\n    """Return the area."""\n    return'),
        ("encoder/numbers.py", "TWO = 2", 'TWO = (\n    2\n)\n"""Two."""'),
        ("encoder/numbers.py", "THREE = 3", "THREE = 4"),
        ("encoder/other.py", "", "def other():\n    return 1\n"),
    ],
    ids=["comment", "docstring", "formatting", "unused", "new"],
)
def test_what_does_not_run_plays_no_part(edit: Edit, name: str, old: str, new: str) -> None:
    """Comments, docstrings, formatting and unused definitions leave a digest alone."""
    before = code_digest(PROGRAM)
    edit(name, old, new)
    assert code_digest(PROGRAM) == before


def test_a_move_changes_nothing(edit: Edit) -> None:
    """A definition that goes to another module, with all imports, leaves a digest alone."""
    before = code_digest(PROGRAM)
    edit("encoder/numbers.py", "TWO = 2\n", "")
    edit("dvc/constants.py", "", "TWO = 2\n")
    edit("encoder/shapes.py", "from encoder.numbers import TWO", "from dvc.constants import TWO")
    assert code_digest(PROGRAM) == before


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("encoder/numbers.py", "TWO = 2", "TWO = 3"),
        ("encoder/shapes.py", "math.pi", "3"),
        ("encoder/shapes.py", "import TWO", "import THREE as TWO"),
        ("encoder/numbers.py", "THREE = 3", "THREE = 3\nprint(THREE)"),
        ("encoder/__main__.py", "area(1)", "area(2)"),
    ],
    ids=["constant", "function", "import", "side effect", "program"],
)
def test_what_runs_counts(edit: Edit, name: str, old: str, new: str) -> None:
    """A change of anything that a program reaches, through packages too, changes its digest."""
    before = code_digest(PROGRAM)
    edit(name, old, new)
    assert code_digest(PROGRAM) != before


def test_programs_that_are_started_count(edit: Edit) -> None:
    """What an experiment runs as a process belongs to it."""
    before = code_digest([("dvc.rd.run", "run")])
    edit("encoder/numbers.py", "TWO = 2", "TWO = 3")
    assert code_digest([("dvc.rd.run", "run")]) != before


def test_files_beside_a_module_count(edit: Edit) -> None:
    """Data that a module names, and that lies beside it, belongs to it."""
    before = code_digest([("dvc.table", "DATA")])
    edit("dvc/table.json", "{}", "[]")
    assert code_digest([("dvc.table", "DATA")]) != before


def test_encoder_and_decoder_are_reached() -> None:
    """All modules of both programs but for those of other commands are part of their digest."""
    assert len(codec_digest()) == 32
    sources = Sources()
    reached = sources.reached([("encoder", ""), ("decoder", "")])
    assert sources.reached([("decoder", "")]) < reached
    for place in (
        ("decoder.worker", "serve"),
        ("sfm.cameras.bundle_adjustment", "bundle_adjustment"),
        ("dvc.slepian_wolf.turbo.turbo_decoder", "LaneDecoder"),
        ("encoder.tracking", "PointTracker"),
    ):
        assert sources.reached([place]) <= reached
    assert not sources.reached([("dvc.stereo", "")]) <= reached


def test_digests_are_the_same_in_other_processes() -> None:
    """Neither the order of sets nor addresses play a part."""
    program = "from dvc.versions import codec_digest; print(codec_digest())"
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == codec_digest()
