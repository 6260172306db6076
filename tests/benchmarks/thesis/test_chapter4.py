"""Chapter 4 on a small map and its picture: its curves, its signal, and edges as they are written."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.thesis import map_curves
from benchmarks.thesis.chapter4 import (
    CHAPTER,
    EDGE_COLOUR,
    NUM_LEVELS,
    SIGNAL_EDGES,
    high_bands,
    load_material,
    piecewise_signal,
    signal_bands,
    with_edges,
)
from benchmarks.thesis.harness import Task
from benchmarks.thesis.map_curves import (
    EDGES_BPP,
    LINEAR,
    ORDERS,
    Material,
    fixed_edges,
    largest_gain,
    map_curve,
    map_point,
    picture_points,
    standard_point,
)
from dvc.images.chain_code import EdgeCode
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edge_selection import edges_of_jumps
from tests.dibr.scenes import texture, two_discs
from tests.stereo.data import REAL_SETS, real_set

DISCS = two_discs()
MATERIAL = Material("discs", DISCS, 50.0)


def test_edges_as_written_have_one_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many as are allowed, in code words; fewer where fewer are allowed."""
    counts = []
    for bpp in (0.1, 0.05, EDGES_BPP):
        monkeypatch.setattr(map_curves, "EDGES_BPP", bpp)
        edges = fixed_edges(MATERIAL)
        assert 8 * len(edges.data) <= bpp * DISCS.size
        assert edges.maps is None or edges.code is EdgeCode.FIXED
        counts.append(0 if edges.maps is None else edges.maps.count())
    assert counts[0] >= counts[1] >= counts[2] < counts[0]


def test_curves_as_written_share_their_edges(monkeypatch: pytest.MonkeyPatch) -> None:
    """Curves begin at the rate of the edges; each order of the extrapolation gives another curve."""
    monkeypatch.setattr(map_curves, "EDGES_BPP", 0.1)
    edges = fixed_edges(MATERIAL)
    assert edges.maps is not None
    curves = {
        name: map_curve(lambda rate, order=order: map_point(MATERIAL, rate, edges, order), (0.01, 0.2, 0.3))
        for name, order in ORDERS.items()
    }
    for points in curves.values():
        assert len(points) == 2, "the edges take more than the first rate"
        assert {point.edges.count() for point in points} == {edges.maps.count()}
        assert all(
            point.num_bytes <= rate * DISCS.size / 8 for point, rate in zip(points, (0.2, 0.3), strict=True)
        )
    assert len({points[0].psnr_db for points in curves.values()}) == len(ORDERS)
    standard = [standard_point(MATERIAL, rate) for rate in (0.2, 0.3)]
    assert not any(point.edges.count() for point in standard)
    assert largest_gain(curves[LINEAR], standard) > 3


def test_orders_are_those_of_the_thesis() -> None:
    """Symmetric, linear and cubic extension; 0.015 bits a pixel of edges."""
    assert list(ORDERS.values()) == [0, 1, 3]
    assert ORDERS[LINEAR] == 1
    assert EDGES_BPP == 0.015


def test_teddy_has_the_edges_and_gains_of_the_thesis(tmp_path: Path) -> None:
    """At 0.04 bits a pixel, within half a decibel; edges within a thousandth of a bit."""
    real_set("teddy")
    teddy = load_material("teddy", Task(tmp_path, REAL_SETS))
    edges = fixed_edges(teddy)
    assert 8 * len(edges.data) / teddy.depth.size == pytest.approx(EDGES_BPP, abs=1e-3)
    printed = float(CHAPTER.printed["Figure 4.7", "teddy: map at 0.04 bpp, SA9/7lin [dB]"])
    assert map_point(teddy, 0.04, edges).psnr_db == pytest.approx(printed, abs=0.5)


def test_all_but_the_coarsest_high_band_vanish() -> None:
    """Constant, linear and cubic pieces: zero by the shape-adaptive transform, not by the standard one."""
    signal, bands = piecewise_signal(), signal_bands()
    pieces = np.split(signal, np.array(SIGNAL_EDGES) + 1)
    for piece, degree in zip(pieces, (0, 1, 3, 0), strict=True):
        assert np.abs(np.diff(piece, degree + 1)).max() < 1e-12
        assert degree == 0 or np.abs(np.diff(piece, degree)).max() > 1e-5
    standard, adaptive = ([float(np.abs(band).max()) for band in side] for side in bands[1:])
    assert len(adaptive) == len(standard) == NUM_LEVELS
    assert max(adaptive[:-1]) < 1e-12
    assert min(standard) > 0.1


def test_entropy_is_that_of_symbols() -> None:
    """Edges at jumps take it away from a map that is constant in pieces."""
    steps = np.where(np.add.outer(np.arange(64), np.arange(64)) > 60, 40.0, 10.0)
    standard, found = high_bands(steps), high_bands(steps, edges_of_jumps(steps, 1.0))
    assert found.entropy_bpp < 0.1 * standard.entropy_bpp
    assert found.nonzero_share < 0.1 * standard.nonzero_share
    assert found.absolute.shape == steps.shape


def test_points_are_measured_as_files() -> None:
    """The PSNR of a point is that of its map, with the peak of the material."""
    material = Material("discs", DISCS, 50.0)
    point = map_point(material, 0.2)
    assert point.psnr_db == pytest.approx(10 * np.log10(50.0**2 / np.mean((point.depth - DISCS) ** 2)))
    assert point.edges_bpp == 8 * point.edge_bytes / DISCS.size > 0


def test_pictures_have_equal_bits() -> None:
    """The encoder writes the better one of both."""
    picture = np.where(two_discs() > 25, 200, 60).astype(np.uint8)
    (point,) = picture_points(picture, edges_of_jumps(DISCS, 5.0), [0.3])
    assert point.shape_adaptive_db > point.standard_db + 3
    assert point.chosen_db == point.shape_adaptive_db
    (useless,) = picture_points(texture(), edges_of_jumps(DISCS, 5.0), [0.3])
    assert useless.chosen_db == max(useless.standard_db, useless.shape_adaptive_db)


def test_edges_are_drawn_between_samples() -> None:
    """An edge to the right of a sample is at the right side of its square, one below at its bottom."""
    edges = EdgeMaps.none((3, 4))
    edges.between_columns[1, 2], edges.between_rows[0, 0] = 1, 1
    drawn = with_edges(np.zeros((3, 4), np.uint8), edges)
    red = np.argwhere((drawn == EDGE_COLOUR).all(axis=2)).tolist()
    assert red == [[1, 0], [1, 1], [2, 5], [3, 5]]


def test_teddy_is_as_in_the_thesis() -> None:
    """In pixels, holes filled, peak 53."""
    real_set("teddy")
    teddy = load_material("teddy", Task(REAL_SETS, REAL_SETS))
    assert teddy.depth.shape == (375, 450)
    assert (teddy.depth.min(), teddy.depth.max(), teddy.peak) == (12.5, 52.75, 53.0)
