"""Running `dvc-dibr` in this process, and what it answers."""

import json
from pathlib import Path
from typing import Any

import pytest

from dvc.dibr.__main__ import main


def run(*arguments: str) -> int:
    try:
        return main(list(arguments))
    except SystemExit as err:
        return int(err.code or 0)


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    capsys.readouterr()
    assert run(*arguments, "--json", "-") == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    capsys.readouterr()
    before = set(Path().iterdir())
    assert run(*arguments) == 2
    assert set(Path().iterdir()) == before, "nothing half-written"
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("dvc-dibr")
    return line
