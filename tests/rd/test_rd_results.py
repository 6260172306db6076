"""Result files: they are read as written, and damaged ones are refused."""

from pathlib import Path
from typing import Any

import pytest

from dvc.errors import DvcError
from dvc.rd.originals import CodeVersion, Source, code_version, input_digest, values_digest
from dvc.rd.rd_results import (
    POINTS_FOLDER,
    is_finished,
    parse_result,
    read_result,
    read_results,
    write_result,
)
from dvc.rd.specification import Point, Task
from tests.rd.made_up import add_result, result_data, write_results

POINT = Point("clip", "2d", 3, "auto", 2)
TASK = Task(POINT, Source("clip", Path("clip.mkv"), "abc"), CodeVersion("1.0", "def"))


def _store(folder: Path, data: object) -> Path:
    return add_result(folder, TASK.name, data)


def test_results_survive_writing_and_reading(tmp_path: Path) -> None:
    (tmp_path / POINTS_FOLDER).mkdir()
    data = result_data(64.0, 30.0)
    written = write_result(tmp_path, "point", data)
    assert written == parse_result("point", data) == read_results(tmp_path)[0]
    assert (written.rate_kbps, written.psnr_y_db, written.totals.key_psnr_y_db) == (64.0, 30.0, None)
    assert written.options.codec == "2d"


def test_identity_depends_on_configuration_input_and_code() -> None:
    """Another option, input or code gives another identity; the name of the file does not depend on code."""
    other_point = Task(Point("clip", "2d", 4, "auto", 2), TASK.source, TASK.code)
    other_input = Task(POINT, Source("clip", Path("clip.mkv"), "xyz"), TASK.code)
    other_code = Task(POINT, TASK.source, CodeVersion("1.0", "xyz"))
    tasks = (TASK, other_point, other_input, other_code)
    assert len({task.identity for task in tasks}) == 4
    assert len({task.name for task in tasks}) == 3
    assert Task(POINT, TASK.source, CodeVersion("1.0", "def", "a1b2")).identity == TASK.identity


def test_results_of_the_same_code_are_not_measured_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert not is_finished(tmp_path, TASK)
    _store(tmp_path, result_data(60.0, 30.0, identity=TASK.identity))
    assert is_finished(tmp_path, TASK)
    _store(tmp_path, result_data(60.0, 30.0, options=POINT.to_dict()))
    assert not is_finished(tmp_path, TASK)
    assert "another version" in caplog.text
    assert is_finished(tmp_path, TASK, any_version=True)


def _with(section: str, **values: object) -> dict[str, Any]:
    """Return a result with other values in a section; without those that are `...`."""
    data = result_data(60.0, 30.0)
    data[section] = {k: v for k, v in {**data[section], **values}.items() if v is not ...}
    return data


DAMAGED = [
    "",
    "{",
    "[]",
    "null",
    '{"schema": "dvc3d-rd-point/0"}',
    "[" * 100_000,
    "[" * 900 + "]" * 900,
    result_data(60.0, 30.0, identity=3),
    result_data(60.0, 30.0, totals=[]),
    result_data(60.0, 30.0, key={}),
    result_data(float("nan"), 30.0),
    result_data(0.0, 30.0),
    result_data(10**400, 30.0),
    _with("sequence", name="\ud800"),
    _with("sequence", width=True),
    _with("sequence", width=0),
    _with("sequence", frames_per_s=0),
    _with("sequence", digest=...),
    _with("totals", psnr_y_db=...),
    _with("totals", bits={"key": -1}),
    _with("totals", bits={}),
    _with("totals", bits={"key": "many"}),
    _with("options", options={"seed": 2}),
    _with("options", wz_q="1"),
    _with("options", gop=...),
    _with("code", commit=["a"]),
    _with("times", coding_cpu_s="y"),
    result_data(60.0, 30.0, per_frame=[{"type": "key", "index": []}]),
    result_data(60.0, 30.0, per_frame=[{"type": "key", "psnr_y_db": 1e300}]),
    result_data(60.0, 30.0, per_frame={}),
    result_data(60.0, 30.0, commands=[1]),
    result_data(60.0, 30.0, pictures="all"),
]


@pytest.mark.parametrize("data", DAMAGED, ids=range(len(DAMAGED)))
def test_damaged_results_are_refused(tmp_path: Path, data: object, caplog: pytest.LogCaptureFixture) -> None:
    path = _store(tmp_path, data)
    with pytest.raises(DvcError, match=path.stem):
        read_result(path)
    assert not is_finished(tmp_path, TASK)
    assert path.name in caplog.text


def test_reports_leave_damaged_results_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(DvcError, match="no results"):
        read_results(tmp_path)
    write_results(tmp_path / "good")
    _store(tmp_path / "good", "{")
    assert len(read_results(tmp_path / "good")) == 6
    assert "left out" in caplog.text


def test_digest_of_an_input_is_that_of_its_contents(tmp_path: Path) -> None:
    """Name and place of a file play no part; contents do, in a folder of images as well."""
    (tmp_path / "images").mkdir()
    for name, content in (("a", b"1"), ("b", b"1"), ("c", b"2"), ("images/0.png", b"1")):
        (tmp_path / name).write_bytes(content)
    a, b, c = (input_digest(tmp_path / name) for name in "abc")
    assert a == b != c
    assert values_digest({"a": 1, "b": 2}) == values_digest({"b": 2, "a": 1})
    folder = input_digest(tmp_path / "images")
    (tmp_path / "images" / "0.png").write_bytes(b"2")
    assert input_digest(tmp_path / "images") != folder


def test_code_version_is_that_of_the_package() -> None:
    import dvc

    assert code_version().version == dvc.__version__
    assert len(code_version().digest) == 32
