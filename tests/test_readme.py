"""The README and the other documents: examples run, links lead somewhere, names exist."""

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from dvc._jit import cache_folder

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
USAGE = (ROOT / "docs" / "usage.md").read_text(encoding="utf-8")
SMALLER = {
    "176x144": "48x32",
    "--frames 9": "--frames 3",
    "--frames 0 8": "--frames 0 2",
    "--qp 24,30,36": "--qp 36 --anchor-qp 40",
    "--bpp 0.5": "--bpp 4",
}
EXPERIMENTS, ARRAYS = "\n## Experiments\n", "\n## Camera arrays\n"
MEASURED = {"docs/rd.svg"}  # written by measurements
DOCUMENTS = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(language: str, text: str = README) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


def free_port() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return str(probe.getsockname()[1])


def run_shell(script: str, folder: Path) -> None:
    """Run commands one after the other, on a smaller video."""
    for large, small in SMALLER.items():
        script = script.replace(large, small)
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "NUMBA_CACHE_DIR": str(cache_folder()),
        "XDG_CACHE_HOME": str(folder / "cache"),
    }
    done = subprocess.run(
        ["bash", "-euc", script],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=250,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_shell_commands_of_the_readme_run(tmp_path: Path) -> None:
    run_shell("\n".join(blocks("sh")).replace(":5000", f":{free_port()}"), tmp_path)
    assert (tmp_path / "small.dvc").stat().st_size < (tmp_path / "street.dvc").stat().st_size
    assert (tmp_path / "live.dvc").read_bytes() == (tmp_path / "small.dvc").read_bytes()
    assert (tmp_path / "live.mkv").read_bytes() == (tmp_path / "decoded.mkv").read_bytes()


def test_shell_commands_of_usage_run(tmp_path: Path) -> None:
    made = r"dvc-sequences|dvc-encode street.mkv (street|no-feedback).dvc"
    before = [line for block in blocks("sh") for line in block.splitlines() if re.match(made, line)]
    assert len(before) == 3
    examples = [f"python - <<'END'\n{block}END" for block in blocks("python", USAGE)]
    run_shell("\n".join([*before, *blocks("sh", USAGE[: USAGE.index(EXPERIMENTS)]), *examples]), tmp_path)
    assert (tmp_path / "python.dvc").stat().st_size > 100
    assert {"motion.json", "scene.json", "predicted.mkv", "no-feedback.json"} < set(os.listdir(tmp_path))


def test_shell_commands_for_experiments_run(tmp_path: Path) -> None:
    render = blocks("sh")[0].splitlines()[0]
    run_shell(
        "\n".join([render, *blocks("sh", USAGE[USAGE.index(EXPERIMENTS) : USAGE.index(ARRAYS)])]), tmp_path
    )
    assert any((tmp_path / "results" / "street").rglob("*.png"))


def test_shell_commands_for_camera_arrays_run(tmp_path: Path) -> None:
    run_shell("\n".join(blocks("sh", USAGE[USAGE.index(ARRAYS) :])), tmp_path)
    assert {"surfaces", "layers", "sprites", "toy.dibr", "flight.mp4", "toy.html"} < set(os.listdir(tmp_path))


def test_commands_are_run_on_less() -> None:
    script = "".join([*blocks("sh"), *blocks("sh", USAGE)])
    assert all(large in script for large in SMALLER)


def test_python_examples_run(capsys: pytest.CaptureFixture[str]) -> None:
    examples = blocks("python")
    assert examples
    for example in examples:
        exec(compile(example, "README.md", "exec"), {"__name__": "readme"})
    assert int(capsys.readouterr().out.split()[0]) > 50


def test_make_targets_exist() -> None:
    """Every `make` command of the README is a target, and `make` alone lists them all."""
    commands = [line for block in blocks("console") for line in block.splitlines()]
    assert {"make demo", "make test"} <= set(commands)
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = re.findall(r"^([a-z-]+):.*##", makefile, flags=re.MULTILINE)
    assert {command.split()[1] for command in commands} <= set(targets)
    shown = subprocess.run(["make", "-C", str(ROOT)], capture_output=True, text=True, check=True).stdout
    assert all(target in shown for target in targets)


def test_continuous_integration_runs_the_tests_of_the_readme() -> None:
    """The script calls `make test` and `make check`, and the workflow calls the script."""
    script = ROOT / ".ci" / "run"
    assert os.access(script, os.X_OK)
    assert {"make test", "make check"} <= set(script.read_text(encoding="utf-8").splitlines())
    assert "run: .ci/run" in (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_to_files(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    targets = re.findall(r"\]\((?!https?:)([^)#]+)", text)
    places = [(document.parent / target).resolve() for target in targets]
    missing = {str(place.relative_to(ROOT)) for place in places if not place.exists()}
    assert missing <= MEASURED


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_documents_name_modules_that_exist(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    paths = re.findall(r"`((?:dvc|encoder|decoder|sfm|sequences|benchmarks|tests|docs)/[\w/.]*)`", text)
    missing = [path for path in paths if not (ROOT / path).exists()]
    for name in re.findall(r"`((?:dvc|encoder|decoder|sfm|sequences|benchmarks)(?:\.\w+)+)`", text):
        parts = name.split(".")
        stems = [ROOT.joinpath(*parts[:count]) for count in range(len(parts), 0, -1)]
        if parts[-1] != "py" and not any(
            stem.is_dir() or stem.with_suffix(".py").exists() for stem in stems[:2]
        ):
            missing.append(name)
    assert missing == []


def test_documented_fields_are_written() -> None:
    """Every field of results in docs/rd.md stands in the code, whole or behind what varies."""
    text = (ROOT / "docs" / "rd.md").read_text(encoding="utf-8")
    packages = [ROOT / package for package in ("dvc", "encoder", "decoder", "benchmarks")]
    code = "\n".join(path.read_text() for package in packages for path in package.rglob("*.py"))
    words = set(re.findall(r"\w+", code))
    fields = set(re.findall(r"`([a-z]+(?:_[a-z0-9]+)+)`", text))
    assert len(fields) > 40
    assert {field for field in fields - words if f"_{field.partition('_')[2]}" not in words} == set()


def test_tour_has_every_package() -> None:
    text = (ROOT / "docs" / "tour.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\* `([\w/]+)/`: ", text, flags=re.MULTILINE)
    folders = {
        "/".join(path.relative_to(ROOT).parts[:-1][:2])
        for package in ("dvc", "encoder", "decoder", "sfm", "sequences", "benchmarks")
        for path in (ROOT / package).rglob("*.py")
    }
    assert sorted(rows) == sorted(folders)


def test_keys_of_references_are_listed() -> None:
    """Every key under References in a docstring and every key of the glossary is in docs/references.md."""
    listed = set(
        re.findall(r"^\* \[(\S+)\] ", (ROOT / "docs" / "references.md").read_text(), flags=re.MULTILINE)
    )
    used = set(re.findall(r"(?<!`)\[([A-Z]\S+)\](?!\()", (ROOT / "docs" / "glossary.md").read_text()))
    for package in ("dvc", "encoder", "decoder", "sequences"):
        for path in (ROOT / package).rglob("*.py"):
            for section in re.findall(r"References\n *-+\n(.*?)\"\"\"", path.read_text(), flags=re.DOTALL):
                used |= set(re.findall(r"^ *\[(\S+)\] ", section, flags=re.MULTILINE))
    assert used <= listed
