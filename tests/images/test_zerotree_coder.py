"""Zerotree coder: round trips at any size, every cut of the data, its twin, masks, damage."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.errors import BitstreamError
from dvc.images import _kernels as kernels
from dvc.images import zerotree_coder as coder
from dvc.images.lifting import Details, Pyramid, Transform, most_levels, scale_shapes
from dvc.images.zerotree_coder import Forest, significance_maps, zerotrees
from tests.reference import entropy as entropy_twin
from tests.reference.spiht import SpihtTwin

SIZES = st.integers(1, 40)


def laplacian(forest: Forest, seed: int, scale: float = 20.0) -> np.ndarray:
    """Draw coefficients that are larger at coarse scales, and often zero."""
    rng = np.random.default_rng(seed)
    values = np.zeros(forest.num_nodes)
    for band in forest.bands:
        band.of(values)[:] = rng.laplace(scale=scale * 1.7**band.level / 8, size=band.shape)
    return values * forest.exists


def masked_forest(shape: tuple[int, int], num_levels: int, keep: float, seed: int) -> Forest:
    rng = np.random.default_rng(seed)
    empty = Transform(num_levels).analyse(np.zeros(shape))

    def draw(band: np.ndarray) -> np.ndarray:
        return (rng.random(band.shape) < keep).astype(float)

    details = tuple(Details(*(draw(band) for band in each)) for each in empty.details)
    return zerotrees([shape], [num_levels], [Pyramid(draw(empty.low), details)])


@given(
    SIZES, SIZES, st.integers(0, 7), st.booleans(), st.just(1.0) | st.floats(0.0, 1.0), st.integers(0, 1000)
)  # fmt: skip
def test_coefficients_come_back(
    rows: int, columns: int, num_levels: int, adaptive: bool, keep: float, seed: int
) -> None:
    forest = zerotrees([(rows, columns)], [num_levels])
    if keep < 1.0:
        forest = masked_forest((rows, columns), num_levels, keep, seed)
    coefficients = laplacian(forest, seed)
    code = coder.encode(forest, coefficients, adaptive=adaptive)
    decoded = coder.decode(forest, code.data, code.num_planes, adaptive)
    assert np.array_equal(decoded.values, np.trunc(coefficients).astype(np.int32))
    error = float(np.sum((decoded.reconstruct((0.4, 0.48)) - coefficients) ** 2))
    assert code.squared_error[-1] == pytest.approx(error, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("adaptive", [True, False])
@pytest.mark.parametrize("shapes", [[(13, 9)], [(6, 11), (3, 4)]])
def test_every_cut_is_a_prefix(adaptive: bool, shapes: list[tuple[int, int]]) -> None:
    forest = zerotrees(shapes, [3] * len(shapes))
    coefficients = laplacian(forest, 5, 100.0)
    code = coder.encode(forest, coefficients, adaptive=adaptive)
    exact, existing = np.abs(coefficients), forest.exists
    last, errors = None, []
    for length in range(len(code.data) + 1):
        known = coder.decode(forest, code.data[:length], code.num_planes, adaptive)
        low = np.abs(known.values.astype(float))
        found = known.values != 0
        assert np.all(low[found] <= exact[found])
        assert np.all(exact[found] < low[found] + 2.0 ** known.last_planes[found])
        assert np.all(np.sign(known.values[found]) == np.sign(coefficients[found]))
        if last is not None:
            assert np.all(known.last_planes <= last.last_planes)
        last = known
        errors.append(float(np.sum((known.reconstruct((0.4, 0.48)) - coefficients)[existing] ** 2)))
    assert errors[0] == pytest.approx(np.sum(coefficients**2))
    assert errors[-1] < errors[len(errors) // 2] < errors[0]
    assert errors == sorted(errors, reverse=True) or np.diff(errors).max() < 0.02 * errors[0]


@given(SIZES, SIZES, st.integers(1, 200), st.booleans())
@settings(max_examples=30)
def test_shorter_budgets_are_prefixes(rows: int, columns: int, max_bytes: int, adaptive: bool) -> None:
    forest = zerotrees([(rows, columns)], [4])
    coefficients = laplacian(forest, rows * columns)
    whole = coder.encode(forest, coefficients, adaptive=adaptive)
    short = coder.encode(forest, coefficients, max_bytes, adaptive)
    assert short.data == whole.data[:max_bytes]
    assert short.num_planes == whole.num_planes


@pytest.mark.parametrize(
    ("shape", "num_levels"), [((1, 1), 0), ((1, 9), 3), ((7, 5), 2), ((8, 8), 3), ((6, 13), 4), ((11, 11), 1)]
)
def test_decisions_are_those_of_the_twin(shape: tuple[int, int], num_levels: int) -> None:
    forest = zerotrees([shape, (3, 4)], [num_levels, 2])
    for seed in range(5):
        coefficients = np.trunc(laplacian(forest, seed, 10.0 + 10 * seed))
        code = coder.encode(forest, coefficients, adaptive=False)
        bands = {
            (band.component, band.level, band.kind): band.of(coefficients).astype(int)
            for band in forest.bands
        }
        decisions = SpihtTwin(bands, code.num_planes).write()
        parts = [entropy_twin.of_decision(0.5, decision) for decision in decisions]
        assert code.data.rstrip(b"\0") == entropy_twin.as_bytes(parts).rstrip(b"\0")


@pytest.mark.nojit
def test_small_streams_as_plain_python() -> None:
    forest = zerotrees([(5, 6)], [2])
    values = np.array([((7 * k) % 23 - 11) * (1 + (k % 5 == 0) * 9) for k in range(30)], float).reshape(5, 6)
    coefficients = forest.gather([Transform(2).analyse(values)])
    code = coder.encode(forest, coefficients)
    decoded = coder.decode(forest, code.data, code.num_planes)
    assert np.array_equal(decoded.values, np.trunc(coefficients).astype(np.int32))
    half = coder.decode(forest, code.data[:15], code.num_planes)
    assert 0 < np.count_nonzero(half.values) < np.count_nonzero(decoded.values)


def test_a_mask_saves_bytes() -> None:
    whole, tenth = zerotrees([(64, 64)], [4]), masked_forest((64, 64), 4, 0.1, 0)
    sizes = [len(coder.encode(forest, laplacian(forest, 1, 200.0)).data) for forest in (whole, tenth)]
    assert 0.05 < sizes[1] / sizes[0] < 0.2


@given(st.integers(1, 90), st.integers(1, 90), st.integers(0, 8))
@settings(max_examples=40)
def test_each_coefficient_is_in_one_tree(rows: int, columns: int, num_levels: int) -> None:
    forest = zerotrees([(rows, columns)], [num_levels])
    assert np.count_nonzero(forest.exists) == rows * columns
    numbers = {(band.level, band.kind): band for band in forest.bands}
    roots, parents, grandparents = [], set(), set()
    for band in forest.bands:
        above = numbers.get((band.level + 1, band.kind)) if band.kind and 0 not in band.shape else None
        for row, column in np.ndindex(*band.shape):
            node = band.first + row * band.stride + column
            if above is None or 0 in above.shape:
                roots.append(node)
                continue
            place = min(row // 2, above.shape[0] - 1), min(column // 2, above.shape[1] - 1)
            parent = above.first + place[0] * above.stride + place[1]
            found = kernels.parent_at(forest.table, forest.table[forest.marks[node, 0]], row, column)
            assert found == parent
            parents.add(parent)
            grandparents.update({parent} if forest.marks[node, 1] & kernels.HAS_CHILDREN else ())
    assert np.array_equal(forest.roots, roots)
    for flag, nodes in ((kernels.HAS_CHILDREN, parents), (kernels.HAS_GRANDCHILDREN, grandparents)):
        assert set(np.flatnonzero(forest.marks[:, 1] & flag).tolist()) == nodes


@given(st.binary(max_size=120), st.integers(0, 30), st.booleans(), st.integers(1, 33), st.integers(1, 33))
def test_any_bytes_are_read_or_refused(
    data: bytes, num_planes: int, adaptive: bool, rows: int, columns: int
) -> None:
    forest = zerotrees([(rows, columns)], [3])
    try:
        decoded = coder.decode(forest, data, num_planes, adaptive)
    except BitstreamError:
        return
    assert np.all(np.abs(decoded.values.astype(np.int64)) < 2**num_planes)
    assert np.all(decoded.values[~forest.exists] == 0)


def test_flipped_bits_never_crash() -> None:
    forest = zerotrees([(40, 33)], [5])
    code = coder.encode(forest, laplacian(forest, 2, 50.0))
    rng = np.random.default_rng(0)
    for _ in range(300):
        damaged = bytearray(code.data)
        damaged[rng.integers(len(damaged))] ^= 1 << rng.integers(8)
        try:
            decoded = coder.decode(forest, bytes(damaged), code.num_planes)
        except BitstreamError:
            continue
        assert np.all(np.abs(decoded.values.astype(np.int64)) < 2**code.num_planes)


@pytest.mark.parametrize("shape", [(1, 1), (9, 13)])
def test_any_budget_is_accepted(shape: tuple[int, int]) -> None:
    forest = zerotrees([shape], [0])
    coefficients = np.linspace(-1.0, 1.0, forest.num_nodes) * (2.0**coder.MAX_PLANES - 1) * forest.exists
    code, same = (coder.encode(forest, coefficients, most) for most in (2**60, 100 + 32 * forest.num_nodes))
    assert code.data == same.data
    values = coder.decode(forest, code.data, code.num_planes).values
    assert np.array_equal(values, np.trunc(coefficients).astype(np.int32))


def test_wrong_arguments_are_named() -> None:
    forest = zerotrees([(2, 2)], [1])
    with pytest.raises(ValueError, match="`coefficients`"):
        coder.encode(forest, np.full(forest.num_nodes, np.nan))
    with pytest.raises(BitstreamError, match="31 bit planes"):
        coder.decode(forest, b"", 31)


def test_zeros_take_no_bytes() -> None:
    forest = zerotrees([(8, 8)], [3])
    code = coder.encode(forest, np.full(forest.num_nodes, 0.9) * forest.exists)
    assert (code.data, code.num_planes) == (b"", 0)
    assert code.squared_error.tolist() == pytest.approx([64 * 0.81])
    assert not coder.decode(forest, b"", 0).values.any()


@given(SIZES, SIZES)
def test_significance_is_that_of_any_orientation(rows: int, columns: int) -> None:
    forest = zerotrees([(rows, columns)], [2])
    coefficients = laplacian(forest, rows + 50 * columns, 2.0)
    code = coder.encode(forest, coefficients)
    levels = max(most_levels((rows, columns)), 2)
    maps = significance_maps(
        forest.bands, coder.decode(forest, code.data, code.num_planes), (rows, columns), levels
    )
    assert [each.shape for each in maps] == scale_shapes((rows, columns), levels)[1:]
    for level, each in enumerate(maps, 1):
        if level > 2:
            assert each.all()
            continue
        bands = [np.trunc(b.of(coefficients)) for b in forest.bands if b.level == level and b.kind]
        for m, n in np.ndindex(*each.shape):
            inside = [band[m, n] for band in bands if m < band.shape[0] and n < band.shape[1]]
            assert each[m, n] == any(inside)
