"""Tables of the thesis beside ours, and the scene of figure 2.4."""

import json
from pathlib import Path

import numpy as np
import pytest

from dvc.stereo.__main__ import main
from dvc.stereo.surfaces.surface import Reconstruction, Surface
from dvc.stereo.thesis.pictures import figure_2_4, pair_group
from dvc.stereo.thesis.reproduce import DOCUMENT, PAGE, VALUES, Chapter, write_chapter
from dvc.stereo.thesis.tables import OURS, markdown, table_2_1, table_2_2, table_2_3
from dvc.stereo.thesis.two_planes import FAR, LABELS, NEAR, two_planes


def test_two_planes_are_where_the_truth_says() -> None:
    """A point of one view is where its disparity puts it in another, unless the square hides it."""
    array, truth = two_planes()
    for source, view in enumerate(array):
        for target, other in enumerate(array):
            shift = other.position.m - view.position.m
            y, x = np.indices(array.shape)
            to_x = (x - shift * truth[source]).astype(np.int64)
            inside = (to_x >= 0) & (to_x < array.shape[1])
            there = y[inside], to_x[inside]
            seen = truth[target][there] == truth[source][inside]
            np.testing.assert_array_equal(view.image[inside][seen], other.image[there][seen])
            assert seen.mean() > 0.8
    assert LABELS.lowest < FAR < NEAR < LABELS.highest


def test_table_2_1_has_the_rows_of_both() -> None:
    """Rows of the thesis come first; of ours there are all masks; the last column is the mean."""
    by_set = {name: {"all": 1.0, "nonocc": 0.5, "disc": 2.0} for name in ("tsukuba", "venus", "teddy")}
    table = table_2_1({OURS: {**by_set, "cones": {"all": 3.0, "nonocc": 0.5, "disc": 2.0}}})
    assert table.rows[0] == ("thesis: proposed method", "1.53", "1.04", "10.90", "8.65", "5.53")
    assert table.rows[2] == (OURS, "1.00", "1.00", "1.00", "3.00", "1.50")
    assert len(table.rows) == 2 + 3


def test_tables_2_2_and_2_3_stand_beside_the_thesis() -> None:
    """Each number of cameras has its rows, and values are counted against one disparity map."""
    table = table_2_2({2: {"all": 1.4}, 25: {"all": 1.1}})
    assert table.rows[0][1] == "1.40"
    assert len(table.rows) == 4 + 2
    table = table_2_3(1000, {25: (1200, 50, 3)})
    assert table.rows[1] == ("layered image, 25 cameras", "1200", "+20.0 %", "3", "50", "127 000", "+19.4 %")
    text = markdown(table)
    assert text.splitlines()[5] == "| --- | ---: | ---: | ---: | ---: | ---: | ---: |"
    assert "| layered image, 25 cameras | 1200 |" in text


def test_missing_sets_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A folder without the sets is refused in one line, before any work."""
    (tmp_path / "tsukuba").mkdir()
    assert main(["reproduce", "--data", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert "there is no venus" in captured.err
    assert not (tmp_path / "out").exists()


def test_figures_are_drawn(tmp_path: Path) -> None:
    """What steps leave in a chapter becomes tables, pictures, a page and their numbers."""
    array, truth = two_planes()
    chapter = Chapter(tmp_path)
    surfaces = [
        Surface(
            disparity.astype(np.float32), np.zeros(array.shape, np.bool_), np.ones(array.shape, np.float32)
        )
        for disparity in truth
    ]
    found = Reconstruction(array, LABELS, tuple(surfaces))
    chapter.figures["2.4"] = figure_2_4(truth, {1: found, 2: found})
    everywhere = np.ones(array.shape, np.bool_)
    chapter.groups.append(pair_group("planes", array[0], truth[0], everywhere, LABELS, {OURS: truth[0]}))
    chapter.tables.append(table_2_2({2: {"all": 1.4}}))
    chapter.values["bad_percent"] = 1.4
    write_chapter(tmp_path, chapter)
    assert {path.name for path in tmp_path.iterdir()} == {DOCUMENT, VALUES, PAGE, "figure-2.4.png"}
    text = (tmp_path / DOCUMENT).read_text()
    assert "StereoSGBM of OpenCV" in text
    assert text.index("## Table 2.2") < text.index("(figure-2.4.png)")
    assert json.loads((tmp_path / VALUES).read_text()) == {"bad_percent": 1.4}
    panels = chapter.figures["2.4"]
    assert panels.shape[1] == 3 * 2 * array.shape[1] + 2 * 8
    assert "0.00 % bad" in (tmp_path / PAGE).read_text()
