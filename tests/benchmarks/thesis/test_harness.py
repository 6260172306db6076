"""The harness: cached steps, when they are repeated, and pages."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from benchmarks.thesis.harness import (
    METHODS,
    Chapter,
    Figure,
    Method,
    Step,
    StepResult,
    Task,
    Value,
    file_name,
    measure,
)
from dvc.web.gallery import Table
from dvc.web.plotting import Line, line_plot

TIMEOUT_MS = 60_000
MADE: list[tuple[str, Method]] = []


def _make(name: str, failure: str, task: Task, method: Method) -> StepResult:
    """Make a step, and note that it was made."""
    MADE.append((name, method))
    made = StepResult([Value("Table 9.1", f"{name} [dB]", 1.25 if method is Method.DEFAULT else 1.0)])
    made.tables.append(Table("Points", "Some more", ("", "dB"), (("a", "1"),)))
    made.pictures["9.2", f"set {name}"] = np.full((20, 30, 3), 90, np.uint8)
    made.plots["9.3b", name] = line_plot([Line("l", [1.0, 2.0], [3.0, 4.0])], "t", "x", "y")
    made.failures += [failure] if failure else []
    return made


def _chapter(failure: str = "", steps: Callable[[Task], list[Step]] | None = None) -> Chapter:
    usual = [
        Step("first", partial(_make, "first", failure)),
        Step("once", partial(_make, "once", ""), (Method.THESIS,)),
    ]
    return Chapter(
        9,
        "made up",
        {("Table 9.1", "first [dB]"): "1.10", ("Table 9.1", "never measured"): "3"},
        (
            Figure("9.1", "an outline", "a diagram of the method"),
            Figure("9.2", "a set"),
            Figure("9.3", "a plot"),
        ),
        ("What S is.",),
        steps or (lambda task: usual),
    )


@pytest.fixture(autouse=True)
def nothing_made() -> None:
    """Forget earlier steps."""
    MADE.clear()


def test_numbers_stand_in_three_columns(tmp_path: Path) -> None:
    """Printed, as written and ours; a dash for missing values; figures are drawn or have a reason."""
    assert measure(_chapter(), Task(tmp_path), METHODS) == []
    text = (tmp_path / "chapter9.md").read_text()
    assert "|  | printed in the thesis | as written | ours |" in text
    assert "| first [dB] | 1.10 | 1.00 | 1.25 |" in text
    assert "| once [dB] | – | 1.00 | – |" in text
    assert "| never measured | 3 | – | – |" in text
    assert "| 9.1 | an outline | not drawn: a diagram of the method |" in text
    assert "| 9.3 | a plot | drawn |" in text
    assert "- What S is." in text
    names = [line.rpartition("(")[2].rstrip(")") for line in text.splitlines() if line.startswith("![")]
    assert len(names) == len(set(names)) == 6
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in names)
    assert (tmp_path / "figure-9.3b-first-ours.svg").is_file()
    values = json.loads((tmp_path / "chapter9.json").read_text())
    assert {
        "source": "Table 9.1",
        "label": "first [dB]",
        "printed": "1.10",
        "method": "ours",
        "value": 1.25,
    } in values


def test_what_is_done_is_kept(tmp_path: Path) -> None:
    """A second run makes nothing; another method makes only that; steps without a file are repeated."""
    measure(_chapter(), Task(tmp_path), (Method.DEFAULT,))
    assert MADE == [("first", Method.DEFAULT)]
    measure(_chapter(), Task(tmp_path), METHODS)
    assert MADE == [("first", Method.DEFAULT), ("first", Method.THESIS), ("once", Method.THESIS)]
    before = (tmp_path / "chapter9.md").read_bytes()
    measure(_chapter(), Task(tmp_path), METHODS)
    assert len(MADE) == 3
    assert (tmp_path / "chapter9.md").read_bytes() == before
    (tmp_path / file_name("9.2", "set first", Method.DEFAULT)).unlink()
    measure(_chapter(), Task(tmp_path), METHODS)
    assert MADE[3:] == [("first", Method.DEFAULT)]


def test_another_task_is_measured_anew(tmp_path: Path) -> None:
    """Neither results of another preset nor damaged ones are taken; the number of cores plays no part."""
    measure(_chapter(), Task(tmp_path), (Method.DEFAULT,))
    measure(_chapter(), Task(tmp_path, jobs=2), (Method.DEFAULT,))
    assert len(MADE) == 1
    measure(_chapter(), Task(tmp_path, full=True), (Method.DEFAULT,))
    assert len(MADE) == 2
    (tmp_path / "steps" / "first-ours.json").write_text("{}")
    measure(_chapter(), Task(tmp_path, full=True), (Method.DEFAULT,))
    assert len(MADE) == 3


def test_files_of_other_contents_are_measured_anew(tmp_path: Path) -> None:
    task = Task(tmp_path / "out", chosen=(str(tmp_path / "map.pfm"), "teddy"))
    for contents, count in ((b"a", 1), (b"a", 1), (b"b", 2)):
        (tmp_path / "map.pfm").write_bytes(contents)
        measure(_chapter(), task, (Method.DEFAULT,))
        assert len(MADE) == count


def test_failed_steps_are_repeated(tmp_path: Path) -> None:
    assert measure(_chapter("no rate"), Task(tmp_path), (Method.DEFAULT,)) == ["no rate"]
    assert "1.25" in (tmp_path / "chapter9.md").read_text()
    assert measure(_chapter(), Task(tmp_path), (Method.DEFAULT,)) == []
    assert len(MADE) == 2


def test_steps_that_are_broken_off_leave_nothing(tmp_path: Path) -> None:

    def _broken(task: Task, method: Method) -> StepResult:
        raise KeyboardInterrupt

    steps = [Step("first", partial(_make, "first", "")), Step("second", _broken)]
    with pytest.raises(KeyboardInterrupt):
        measure(_chapter(steps=lambda task: steps), Task(tmp_path), (Method.DEFAULT,))
    assert [path.name for path in (tmp_path / "steps").iterdir()] == ["first-ours.json"]
    assert not (tmp_path / "chapter9.md").exists()
    measure(_chapter(), Task(tmp_path), (Method.DEFAULT,))
    assert len(MADE) == 1


def test_page_opens_without_an_error_or_a_request(browser: Browser, tmp_path: Path) -> None:
    """Nothing is logged or loaded, all pictures are there, both ways can be laid over each other."""
    measure(_chapter(), Task(tmp_path), METHODS)
    page = browser.new_page()
    logged: list[str] = []
    requests: list[str] = []
    page.on("console", lambda message: logged.append(message.text))
    page.on("pageerror", lambda error: logged.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    address = (tmp_path / "index.html").as_uri()
    page.goto(address, timeout=TIMEOUT_MS)
    assert logged == []
    assert [url for url in requests if not url.startswith("data:")] == [address]
    assert page.evaluate("[...document.images].every((image) => image.complete && image.naturalWidth > 0)")
    assert page.locator("section[data-group] img").count() == 6
    assert page.locator("#left option").count() == 2
    page.close()
