"""Edges as pictures: what is read is what was written; what is no picture of edges is refused."""

from pathlib import Path

import numpy as np
import pytest

from dvc.errors import DvcError
from dvc.images.edge_extraction import read_edges, write_edges
from dvc.images.edge_maps import EdgeMaps
from dvc.picture_files import write_png

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
