"""Edge maps and their pyramid (4.5)."""

from pathlib import Path

import numpy as np
import pytest

from dvc.errors import DvcError
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edge_selection import read_edges, write_edges
from dvc.picture_files import write_png


def test_coarse_samples_are_separated_where_fine_ones_are():
    rng = np.random.default_rng(0)
    for shape in ((8, 8), (7, 9), (1, 5), (5, 1), (2, 3)):
        below, right = ((rng.random(shape) < 0.3).astype(np.uint8) for _ in range(2))
        below[-1], right[:, -1] = 0, 0
        coarse = list(EdgeMaps(below, right).pyramid(2))[1]
        assert coarse.shape == ((shape[0] + 1) // 2, (shape[1] + 1) // 2)
        for s in range(coarse.shape[0] - 1):
            for t in range(coarse.shape[1]):
                assert coarse.between_rows[s, t] == max(below[2 * s, 2 * t], below[2 * s + 1, 2 * t])
        for s in range(coarse.shape[0]):
            for t in range(coarse.shape[1] - 1):
                assert coarse.between_columns[s, t] == max(right[2 * s, 2 * t], right[2 * s, 2 * t + 1])
        assert not coarse.between_rows[-1].any()
        assert not coarse.between_columns[:, -1].any()


def test_a_pyramid_begins_with_the_edges_themselves():
    edges = EdgeMaps.none((9, 9))
    edges.between_rows[3, 4] = 1
    levels = list(edges.pyramid(3))
    assert [level.shape for level in levels] == [(9, 9), (5, 5), (3, 3)]
    assert levels[0] is edges
    assert [level.count() for level in levels] == [1, 1, 1]


def test_edges_beyond_the_plane_are_refused():
    with pytest.raises(ValueError, match="no neighbours"):
        EdgeMaps(np.ones((2, 2), np.uint8), np.zeros((2, 2), np.uint8))
    with pytest.raises(ValueError, match="shape"):
        EdgeMaps(np.zeros((2, 2), np.uint8), np.zeros((2, 3), np.uint8))


SHAPE = (9, 13)


def drawn() -> EdgeMaps:
    """Draw edges, of which some samples have both."""
    below, right = np.random.default_rng(1).integers(0, 2, (2, *SHAPE), dtype=np.uint8)
    below[-1], right[:, -1] = 0, 0
    assert (below & right).any()
    return EdgeMaps(below, right)


def test_edges_come_back(tmp_path: Path) -> None:
    """Both maps, where they cross, too."""
    edges = drawn()
    write_edges(tmp_path / "edges.png", edges)
    read = read_edges(tmp_path / "edges.png", SHAPE)
    np.testing.assert_array_equal(read.between_rows, edges.between_rows)
    np.testing.assert_array_equal(read.between_columns, edges.between_columns)


def test_what_is_no_picture_of_edges_is_refused(tmp_path: Path) -> None:
    """Another size, another level."""
    write_edges(tmp_path / "edges.png", drawn())
    with pytest.raises(DvcError, match="edges of 13x9, but the depth map is 13x8"):
        read_edges(tmp_path / "edges.png", (8, 13))
    write_png(tmp_path / "grey.png", np.full(SHAPE, 84, np.uint8))
    with pytest.raises(DvcError, match="edges have the levels 0, 85, 170, 255"):
        read_edges(tmp_path / "grey.png", SHAPE)
