"""Examples in docstrings run; commands and options that documents name exist."""

import contextlib
import doctest
import importlib
import io
import re
import shlex
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from dvc import cli

ROOT = Path(__file__).resolve().parents[1]
MODULES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for package in ("dvc", "encoder", "decoder", "sfm", "sequences")
    for path in sorted((ROOT / package).rglob("*.py"))
    if ">>>" in path.read_text(encoding="utf-8")
]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")


@pytest.mark.parametrize("name", MODULES)
def test_examples_are_true(name: str) -> None:
    results = doctest.testmod(importlib.import_module(name))
    assert results.attempted > 0
    assert results.failed == 0


def main_of(command: str) -> Callable[[list[str]], int]:
    """Return the `main` of a command."""
    package = {"encode": "encoder", "decode": "decoder", "sequences": "sequences", "sfm": "sfm"}
    name = command.removeprefix("dvc-")
    module = f"{package.get(name, f'dvc.{name}')}.__main__" if name != "compile" else "dvc.compile_kernels"
    main: Callable[[list[str]], int] = importlib.import_module(module).main
    return main


def command_lines(text: str) -> list[list[str]]:
    """Return the commands of this project in the code blocks of a document, as words."""
    blocks = re.findall(r"^```[^\n]*\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    lines = [
        shlex.split(line.rstrip(" &"), comments=True)
        for block in blocks
        for line in block.splitlines()
        if line.startswith("dvc-")
    ]
    return [words for words in lines if words[0] in SCRIPTS]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_commands_are_understood(document: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every command in a code block is one that its program accepts, up to the files that it names."""
    monkeypatch.setattr(cli, "run", lambda prog, command: 0)
    wrong = []
    for words in command_lines(document.read_text(encoding="utf-8")):
        with contextlib.redirect_stderr(io.StringIO()) as told:
            try:
                main_of(words[0])(words[1:])
            except SystemExit as ended:
                wrong.append(f"{shlex.join(words)}: {ended.code} {told.getvalue()}")
    assert wrong == []


@pytest.fixture(scope="module")
def options() -> set[str]:
    """All options of all programs and of their subcommands."""
    found = set[str]()
    for module in ("benchmarks.results.__main__", "benchmarks.thesis.__main__"):
        with contextlib.redirect_stdout(io.StringIO()) as shown, contextlib.suppress(SystemExit):
            importlib.import_module(module).main(["--help"])
        found |= set(OPTION.findall(shown.getvalue()))
    for command in SCRIPTS:
        names: list[list[str]] = [[]]
        for name in names:
            with contextlib.redirect_stdout(io.StringIO()) as told, contextlib.suppress(SystemExit):
                main_of(command)([*name, "--help"])
            found |= set(OPTION.findall(told.getvalue()))
            listed = re.search(r"\{([a-z,-]+)\}", told.getvalue())
            if not name and listed and command not in ("dvc-encode", "dvc-decode", "dvc-sfm"):
                names += [[subcommand] for subcommand in listed[1].split(",")]
    return found


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_options_exist(document: Path, options: set[str]) -> None:
    code = re.findall(r"`([^`]+)`", re.sub(r"^```.*?^```", "", document.read_text(), flags=re.M | re.S))
    code = [text for text in code if "python -m" not in text and not text.startswith("pytest ")]
    named = {option for text in code for option in OPTION.findall(text)}
    assert named <= options
