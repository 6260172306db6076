"""Programs run in a folder of strangers as in an empty one: none of their code and settings count."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from dvc.contracts.test_side_information import moving_texture
from dvc.rd.originals import _git
from tests.clips import write_clip

ROOT = Path(__file__).resolve().parents[1]
STREAM = ROOT / "tests" / "golden" / "streams" / "2d-classical-buffered.dvc"
SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
PACKAGES = "dvc", "encoder", "decoder", "sequences", "sfm"
CODE = "open({!r}, 'a').write(__file__ + '\\n')\nraise SystemExit('code of a stranger')\n"
MODULES = (
    "decoder",
    "dvc",
    "encoder",
    "json",
    "multiprocessing",
    "numpy",
    "pickle",
    "sequences",
    "sitecustomize",
)
NUMBA = "cache_dir: {}\nboundscheck: 1\ncache_locator_classes: Strange\nnum_threads: -1\n"
MATPLOTLIB = "text.usetex: True\nlines.linewidth: 9\nnonsense\n"
DOOR = re.compile("without_settings|new_figure")
LIBRARY = "libc.so.6"
"""All programs need it; the loader ends one that finds another file of this name."""


@pytest.fixture
def strange(tmp_path: Path) -> Iterator[Path]:
    """Return a folder with all that might be read, and check that nothing was."""
    folder, told, cache = tmp_path / "strange", tmp_path / "told", tmp_path / "cache"
    folder.mkdir()
    for name in MODULES:
        (folder / f"{name}.py").write_text(CODE.format(str(told)))
    (folder / ".numba_config.yaml").write_text(NUMBA.format(cache))
    (folder / "matplotlibrc").write_bytes(MATPLOTLIB.encode() + b"# \xff")
    (folder / LIBRARY).write_text("no library")
    before = set(folder.iterdir())
    yield folder
    assert not told.exists()
    assert not cache.exists()
    assert set(folder.iterdir()) == before


@pytest.fixture
def clean(tmp_path: Path) -> Path:
    """Return an empty folder."""
    (tmp_path / "clean").mkdir()
    return tmp_path / "clean"


def start(folder: Path, program: str, *words: object) -> str:
    """Run a command in a folder as its script does; return what it writes on both outputs."""
    module, _, function = SCRIPTS[program].partition(":")
    script = folder.parent / program  # the folder of the script is where Python looks first
    script.write_text(
        f"import {module}\nif __name__ == '__main__':\n    raise SystemExit({module}.{function}())\n"
    )
    return run(folder, str(script), *map(str, words))


def run(folder: Path, *words: str) -> str:
    """Run Python in a folder, without what makes it safe in this one."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    for name in ("PYTHONSAFEPATH", "LD_LIBRARY_PATH"):
        environment.pop(name, None)
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout + done.stderr


def run_program(folder: Path, program: str) -> str:
    """Run a program that lies elsewhere in a folder; return what it prints."""
    path = folder.parent / "program.py"
    path.write_text(program)
    return run(folder, str(path))


def streams(strange: Path, clean: Path) -> list[bytes]:
    """Encode a clip in both folders; return what comes of it."""
    clip = write_clip(clean / "clip.mkv", moving_texture(3, 48, 64))
    outputs = []
    for folder in (strange, clean):
        outputs.append(clean / f"{folder.name}.dvc")
        assert start(folder, "dvc-encode", clip, outputs[-1], "--gop", 2, "--quiet") == ""
    return [output.read_bytes() for output in outputs]


@pytest.mark.parametrize("text", ["", "[", "text", "1: 2"])
def test_settings_of_numba(strange: Path, clean: Path, text: str) -> None:
    if text:
        (strange / ".numba_config.yaml").write_text(text)
    first, second = streams(strange, clean)
    assert first == second


def test_settings_of_numba_when_it_compiles(strange: Path) -> None:
    """It looks for them anew; those that were read by who has imported it before are forgotten."""
    program = (
        "import numba; print(numba.config.BOUNDSCHECK)\n"
        "from dvc._jit import kernel\n"
        "@kernel\ndef one(x):\n    return x + 1\n"
        "one(1); print(numba.config.BOUNDSCHECK)\n"
    )
    (strange / ".numba_config.yaml").write_text("boundscheck: 1\n")
    assert run_program(strange, program).split() == ["1", "None"]


def test_decoder(strange: Path, clean: Path) -> None:
    """Nor does code that lies there run in the processes that decode, Python or shared libraries."""
    decoded = []
    for folder in (strange, clean):
        decoded.append(clean / f"{folder.name}.y4m")
        start(folder, "dvc-decode", STREAM, decoded[-1], "--jobs", 2, "--quiet")
    assert decoded[0].read_bytes() == decoded[1].read_bytes()


def test_experiment(strange: Path, clean: Path) -> None:
    clip, out = write_clip(clean / "clip.mkv", moving_texture(3, 48, 64)), clean / "out"
    start(strange, "dvc-rd", "run", clip, "--gop", 2, "--qp", 34, "--out", out)
    reports = []
    for folder in (strange, clean):
        start(folder, "dvc-rd", "report", out)
        reports.append({path.name: path.read_bytes() for path in out.glob("report*")})
    assert {".svg", ".png", ".md"} <= {Path(name).suffix for name in reports[0]}
    assert reports[0] == reports[1]


def test_spawned_processes(strange: Path) -> None:
    program = (
        "import os\nfrom multiprocessing import get_context\n"
        "from dvc.environment import baseline_environment\n"
        "if __name__ == '__main__':\n"
        "    import cv2\n    os.environ |= baseline_environment()\n"
        "    with get_context('spawn').Pool(1) as pool:\n        print(pool.map(abs, [-1]))\n"
    )
    assert run_program(strange, program) == "[1]\n"


def test_compiler_of_kernels(strange: Path) -> None:
    start(strange, "dvc-compile", "--jobs", 1)


def test_repository(tmp_path: Path) -> None:
    program, told = tmp_path / "program", tmp_path / "told"
    program.write_text(f"#!/bin/sh\ntouch {told}\n")
    program.chmod(0o755)
    for words in (["init", "--quiet"], ["config", "core.fsmonitor", str(program)], ["add", "program"]):
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True)
    told.unlink(missing_ok=True)
    assert _git(tmp_path, "ls-files", "--error-unmatch", "program") == "program"
    assert not told.exists()


def _parsed(*packages: str) -> Iterator[tuple[str, ast.Module]]:
    for path in sorted(path for package in packages for path in (ROOT / package).rglob("*.py")):
        yield str(path.relative_to(ROOT)), ast.parse(path.read_text(encoding="utf-8"))


def test_python_is_started_in_one_place() -> None:
    found = {
        name
        for name, tree in _parsed(*PACKAGES, "benchmarks")
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and ast.unparse(node) == "sys.executable"
    }
    assert found == {"dvc/environment.py"}


def test_children_get_an_environment() -> None:
    """One that `child_environment` is part of; what starts processes by itself takes that of this one."""
    starting = r"subprocess\.(run|Popen|call|check_\w+)|os\.(system|popen|exec\w+|spawn\w+|posix_spawn\w*)"
    wrong = []
    for name, tree in _parsed(*PACKAGES):
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            called = ast.unparse(node.func)
            given = next((ast.unparse(word.value) for word in node.keywords if word.arg == "env"), "")
            if re.fullmatch(starting, called) and not re.search(r"(child|baseline)_environment\(\)", given):
                wrong.append(f"{name}:{node.lineno}")
    assert wrong == []
    text = {name: ast.unparse(tree) for name, tree in _parsed(*PACKAGES, "benchmarks")}
    by_themselves = {name for name in text if re.search(r"get_context\(|ProcessPoolExecutor\(", text[name])}
    assert by_themselves == {"benchmarks/hostile/workers.py", "benchmarks/searches/settings.py"}
    assert all(re.search(r"environ.*(child|baseline)_environment\(\)", text[name]) for name in by_themselves)


def test_libraries_with_settings_have_one_door() -> None:
    """Numba and matplotlib are imported where `without_settings` hides files from them."""
    found = set()
    for name, tree in _parsed(*PACKAGES, "benchmarks"):
        hidden = {
            inner
            for node in ast.walk(tree)
            if (
                isinstance(node, ast.With)
                and re.match("without_settings|new_figure", ast.unparse(node.items[0]))
            )
            or (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
            for inner in ast.walk(node)
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.Import | ast.ImportFrom) and node not in hidden:
                modules = [getattr(node, "module", None), *(alias.name for alias in node.names)]
                found |= {name for module in modules if str(module).startswith(("numba", "matplotlib"))}
    assert found == set()
