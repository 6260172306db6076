"""Matching costs: census and squared differences at every disparity, against their definitions."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dvc.geometry import matching_costs
from dvc.geometry.camera_array import ArrayView, DisparityLabels, LatticePosition
from dvc.geometry.matching_costs import COSTS, DEAD_ZONE, Band, census, offsets, phases
from tests.reference import cost_volumes as reference
from tests.reference.stereo_volumes import banded
from tests.twins import Choose

SHAPE = (7, 9)


def smooth_view(
    name: str, m: float, n: float, disparity: float, shape: tuple[int, int] = (24, 40)
) -> ArrayView:
    """Return the view of camera (m, n) of a smooth picture at one disparity."""
    y, x = np.indices(shape, np.float64)
    x, y = x + m * disparity, y + n * disparity
    levels = [128 + 50 * np.sin(0.5 * x + k) + 40 * np.cos(0.43 * y - 0.2 * k * x) for k in range(3)]
    return ArrayView(name, np.rint(np.stack(levels, -1)).astype(np.uint8), LatticePosition(m, n))


def random_view(rng: np.random.Generator, m: float, n: float, *, holes: bool = False) -> ArrayView:
    image = rng.integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
    return ArrayView(f"{m},{n}", image, LatticePosition(m, n), rng.random(SHAPE) < 0.8 if holes else None)


def place(
    x: int, y: int, label: int, shifts: NDArray[np.int64], seen: NDArray[np.bool_]
) -> tuple[int, int, int] | None:
    """Return phase, row and column of a point in the other view; None if it is invalid or unseen."""
    if not 0 <= label < len(shifts):
        return None
    phase, u, v = shifts[label] + (0, x, y)
    inside = 0 <= u < seen.shape[1] and 0 <= v < seen.shape[0]
    return (phase, v, u) if inside and seen[v, u] else None


def every_label(labels: DisparityLabels, shape: tuple[int, int]) -> Band:
    return Band(np.zeros(shape, np.int64), labels.num_labels)


@pytest.mark.nojit
def test_census_cost(choose: Choose, rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (*SHAPE, 3)).astype(np.float32)
    others = rng.integers(0, 256, (2, *SHAPE, 3)).astype(np.float32)
    greys = [picture.mean(axis=2) for picture in (image, *others)]
    texts = [reference.census(grey, 2, 0.0) for grey in greys]
    words = np.array([[[int(text, 2) for text in row] for row in rows] for rows in texts], np.uint32)
    seen = rng.random(SHAPE) < 0.8
    shifts = np.array([[0, 0, 0], [1, -2, 0], [0, -1, 1], [1, 3, -2]])
    bit_table, level_table = rng.random(25).astype(np.float32), rng.random(766).astype(np.float32)
    top, origin = 2, rng.integers(-2, 3, SHAPE)
    cost, weight = np.full((2, 4, SHAPE[1], 3), 9.0, np.float32)
    rows, tables = slice(top, top + 4), (bit_table, level_table, np.float32(0.0))
    pictures = image[rows], words[0][rows], others, words[1:], seen
    with np.errstate(over="ignore"):
        choose(matching_costs._compare)(
            *pictures, np.add(shifts, (0, 0, top)), origin[rows], *tables, cost, weight
        )
    for i, x, k in np.ndindex(cost.shape):
        found = place(x, top + i, origin[top + i, x] + k, shifts, seen)
        expected = 0.0
        if found is not None:
            phase, v, u = found
            bits = reference.hamming(texts[0][top + i, x], texts[1 + phase][v, u])
            levels = int(np.abs(image[top + i, x] - others[phase, v, u]).sum())
            expected = bit_table[bits] + level_table[levels]
        assert weight[i, x, k] == (found is not None)
        assert cost[i, x, k] == pytest.approx(expected, rel=1e-6)
    assert 0 < weight.sum() < weight.size


@pytest.mark.nojit
def test_squared_cost(choose: Choose, rng: np.random.Generator) -> None:
    """The mean over the channels, truncated (2.18), as a share of the limit."""
    image = rng.integers(0, 40, (*SHAPE, 3)).astype(np.float32)
    others = rng.integers(0, 40, (1, *SHAPE, 3)).astype(np.float32)
    seen = rng.random(SHAPE) < 0.8
    shifts = np.array([[0, 0, 0], [0, -2, 0], [0, 1, 3]])
    origin = rng.integers(-1, 2, SHAPE)
    cost, weight = np.full((2, *SHAPE, 3), 9.0, np.float32)
    table, bits = np.zeros(1, np.float32), np.zeros((1, *SHAPE), np.uint32)
    pictures, tables = (image, bits[0], others, bits, seen), (table, table, np.float32(150.0))
    choose(matching_costs._compare)(*pictures, shifts, origin, *tables, cost, weight)
    for y, x, k in np.ndindex(cost.shape):
        found = place(x, y, origin[y, x] + k, shifts, seen)
        error = 0.0 if found is None else float(((image[y, x] - others[found]) ** 2).mean())
        assert weight[y, x, k] == (found is not None)
        assert cost[y, x, k] == pytest.approx(min(error, 150.0) / 150.0, rel=1e-5)
    assert (cost == 1.0).any()


def test_offsets_follow_the_array() -> None:
    """A point of camera (0, 0) is seen farther to the left by a camera to its right (2.5)."""
    labels = DisparityLabels(1.0, 0.5, 3)
    moved = offsets(labels, LatticePosition(0.0, 0.0), LatticePosition(1.0, -2.0))
    np.testing.assert_allclose(moved, [[-1.0, 2.0], [-1.5, 3.0], [-2.0, 4.0]])
    back = offsets(labels, LatticePosition(1.0, -2.0), LatticePosition(0.0, 0.0))
    np.testing.assert_allclose(back, -moved)


def test_phases_are_the_view_between_its_pixels() -> None:
    labels = DisparityLabels(0.0, 0.25, 9)
    view = smooth_view("a", 1.0, 0.0, 0.0)
    pictures, shifts, _ = phases(view, LatticePosition(0.0, 0.5), labels, slice(0, 24))
    assert len(pictures) == 8, "quarters across, with their halves down"
    y, x = np.indices(view.shape, np.float64)
    inner = slice(6, -6), slice(6, -6)
    for k, (phase, dx, dy) in enumerate(shifts):
        u, v = x - 0.25 * k, y + 0.125 * k
        levels = [128 + 50 * np.sin(0.5 * u + c) + 40 * np.cos(0.43 * v - 0.2 * c * u) for c in range(3)]
        found = np.roll(pictures[phase], (-dy, -dx), axis=(0, 1))
        assert np.abs(found - np.stack(levels, -1))[inner].max() < 2.0
    assert (pictures[shifts[0, 0]] == view.image).all(), "whole pixels are not interpolated"
    assert pictures.min() >= 0.0
    assert pictures.max() <= 255.0


@pytest.mark.parametrize("name", sorted(COSTS))
@pytest.mark.parametrize(("m", "n"), [(1.0, 0.0), (0.37, 1.13), (0.0, -2.0), (0.0, 30.0)])
def test_rows_need_no_others(name: str, m: float, n: float, rng: np.random.Generator) -> None:
    """Costs of some rows are those of the whole, and few rows are interpolated for them."""
    shape, labels = (64, 20), DisparityLabels(-1.0, 0.3, 12)
    images = rng.integers(0, 256, (2, *shape, 3)).astype(np.uint8)
    view = ArrayView("a", images[0], LatticePosition(0.0, 0.0))
    other = ArrayView("b", images[1], LatticePosition(m, n), rng.random(shape) < 0.8)
    band = every_label(labels, shape)
    whole = COSTS[name](view, other, labels, band, slice(0, 64))
    for rows in (slice(0, 5), slice(20, 33), slice(60, 64)):
        found = COSTS[name](view, other, labels, band, rows)
        for one, expected in zip(found, whole, strict=True):
            np.testing.assert_array_equal(one, expected[rows])
    needed = phases(other, view.position, labels, slice(20, 30)).pictures.shape[1]
    assert needed <= 10 + 4 * abs(n) + 10


@pytest.mark.parametrize("name", sorted(COSTS))
@pytest.mark.parametrize(("m", "n"), [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.6, -0.9)])
def test_true_disparity_between_pixels_costs_least(name: str, m: float, n: float) -> None:
    labels = DisparityLabels(0.0, 0.25, 17)
    true = 9
    views = [smooth_view("a", 0.0, 0.0, 2.25), smooth_view("b", m, n, 2.25)]
    cost, weight = COSTS[name](*views, labels, every_label(labels, views[0].shape), slice(6, 18))
    total = (cost * weight)[:, 8:-8].sum(axis=(0, 1))
    assert (weight[:, 8:-8] == 1.0).all()
    assert int(total.argmin()) == true
    assert cost.min() >= 0.0
    assert cost.max() <= COSTS[name].highest


@pytest.mark.parametrize("name", sorted(COSTS))
def test_band_has_the_costs_of_its_labels(name: str, rng: np.random.Generator) -> None:
    labels = DisparityLabels(0.0, 0.5, 6)
    view, other = random_view(rng, 0.0, 0.0), random_view(rng, -1.0, 0.5, holes=True)
    origin = rng.integers(-2, 6, SHAPE)
    whole = COSTS[name](view, other, labels, every_label(labels, SHAPE), slice(0, SHAPE[0]))
    part = COSTS[name](view, other, labels, Band(origin, 3), slice(0, SHAPE[0]))
    for a, b in zip(whole, part, strict=True):
        np.testing.assert_array_equal(b, banded(a, origin, 3, 0.0))


@pytest.mark.parametrize("name", sorted(COSTS))
def test_what_the_other_view_does_not_have_has_no_weight(name: str, rng: np.random.Generator) -> None:
    labels = DisparityLabels(0.0, 1.0, 4)
    band = every_label(labels, SHAPE)
    view, other = random_view(rng, 0.0, 0.0), random_view(rng, 1.0, 0.0, holes=True)
    cost, weight = COSTS[name](view, other, labels, band, slice(0, SHAPE[0]))
    assert other.valid is not None
    for k in range(4):
        seen = np.zeros(SHAPE, bool)
        seen[:, k:] = other.valid[:, : SHAPE[1] - k]
        np.testing.assert_array_equal(weight[:, :, k], seen)
        assert not cost[:, :, k][~seen].any()
    assert set(np.unique(weight)) == {0.0, 1.0}


def test_census_is_blind_to_exposure(rng: np.random.Generator) -> None:
    image = rng.integers(0, 200, (*SHAPE, 3)).astype(np.float32)
    np.testing.assert_array_equal(census(image), census(image + np.float32(40.0)))
    noise = rng.uniform(0, 0.9 * DEAD_ZONE, SHAPE)
    flat = np.float32(100.0) + np.repeat(noise[:, :, None], 3, axis=2).astype(np.float32)
    assert not census(flat).any()


@pytest.mark.nojit
@pytest.mark.parametrize("radius", [1, 2])
def test_census_bits(choose: Choose, rng: np.random.Generator, radius: int) -> None:
    """Neighbours that are darker by more than the dead zone, row by row; the border repeats."""
    grey = rng.integers(0, 12, SHAPE).astype(np.float32)
    bits = np.empty(SHAPE, np.uint32)
    choose(matching_costs._census)(np.pad(grey, radius, mode="edge"), radius, np.float32(2.0), bits)
    expected = reference.census(grey.astype(np.float64), radius, 2.0)
    length = (2 * radius + 1) ** 2 - 1
    np.testing.assert_array_equal(np.vectorize(lambda word: f"{word:0{length}b}")(bits), expected)


@pytest.mark.nojit
def test_bits_are_counted(choose: Choose, rng: np.random.Generator) -> None:
    """All words of 64 bits, with none and with all of them set."""
    words = [0, 1, 1 << 63, (1 << 64) - 1, *rng.integers(0, 1 << 64, 50, np.uint64).tolist()]
    with np.errstate(over="ignore"):  # the product wraps around on purpose
        found = [int(choose(matching_costs.count_bits)(np.uint64(word))) for word in words]
    assert found == [word.bit_count() for word in words]
