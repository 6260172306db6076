"""Tables of the thesis beside ours, and the scene of figure 2.4."""

import numpy as np

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
