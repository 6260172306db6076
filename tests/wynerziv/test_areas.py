"""Areas of a frame: which blocks they hold, and choices of them as bytes and back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.entropy import RangeCoder
from dvc.errors import BitstreamError
from dvc.wynerziv import _kernels, areas
from dvc.wynerziv.areas import SIDE, Areas
from tests.twins import Choose

SHAPES = st.tuples(st.integers(1, 40), st.integers(1, 40))


def any_choice(own: Areas, data: st.DataObject) -> np.ndarray:
    """Draw a choice: of single areas, or of a share of them."""
    flags = st.lists(st.booleans(), min_size=own.count, max_size=own.count)
    shares = st.tuples(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
    drawn = data.draw(st.one_of(flags, shares))
    if isinstance(drawn, list):
        return np.array(drawn)
    return np.random.default_rng(drawn[0]).random(own.count) < drawn[1]


def clustered(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Return areas in a few squares, as errors have it."""
    chosen = np.zeros(shape, bool)
    for _ in range(3):
        row, column = rng.integers(0, shape[0] - 5), rng.integers(0, shape[1] - 5)
        chosen[row : row + 5, column : column + 5] = True
    return chosen.ravel()


@pytest.mark.parametrize("band_shape", [(1, 1), (4, 4), (5, 3), (9, 17), (36, 44)])
def test_blocks_are_divided_into_squares(band_shape: tuple[int, int]) -> None:
    """Areas, their sizes, and sums over blocks are those of plain loops, where a border cuts them, too."""
    own, rng = Areas(band_shape), np.random.default_rng(1)
    rows, columns = band_shape
    blocks = np.flatnonzero(rng.random(rows * columns) < 0.7)
    values = rng.normal(0.0, 1.0, blocks.size)
    index, sizes, sums = [], [0] * own.count, [0.0] * own.count
    across = (columns + SIDE - 1) // SIDE
    for row in range(rows):
        for column in range(columns):
            index.append(row // SIDE * across + column // SIDE)
            sizes[index[-1]] += 1
    for block, value in zip(blocks.tolist(), values.tolist(), strict=True):
        sums[index[block]] += value
    assert own.shape == ((rows + SIDE - 1) // SIDE, across)
    assert own.of_blocks.tolist() == index
    assert own.sizes.tolist() == sizes
    np.testing.assert_allclose(own.sums(blocks, values), sums, atol=1e-12)
    nothing = own.sums(blocks[:0], values[:0])
    assert nothing.dtype == np.float64
    assert nothing.tolist() == [0.0] * own.count


@given(SHAPES, st.data())
def test_choices_come_back(band_shape: tuple[int, int], data: st.DataObject) -> None:
    own = Areas(band_shape)
    chosen = any_choice(own, data)
    given_areas = chosen.copy()
    code = own.coded(chosen)
    np.testing.assert_array_equal(chosen, given_areas)
    found = own.decoded(code)
    assert found.dtype == np.bool_
    np.testing.assert_array_equal(found, chosen)
    assert (code == b"") == bool(chosen.all())


@settings(max_examples=300)
@given(
    SHAPES, st.integers(0, 2**32 - 1), st.lists(st.integers(0, 2**16 - 1), max_size=4), st.binary(max_size=5)
)
def test_damaged_choices_are_refused_or_other_choices(
    band_shape: tuple[int, int], seed: int, flips: list[int], end: bytes
) -> None:
    """Damaged bits, and bytes that are added or missing, choose areas of the frame or none."""
    own = Areas(band_shape)
    chosen = np.random.default_rng(seed).random(own.count) < 0.4
    changed = bytearray(own.coded(chosen))
    for flip in flips if changed else []:
        changed[flip // 8 % len(changed)] ^= 1 << flip % 8
    for data in (bytes(changed[: len(changed) - len(end) % 3]) + end, 8 * end):
        try:
            found = own.decoded(data)
        except BitstreamError:
            continue
        assert found.dtype == np.bool_
        assert found.shape == (own.count,)
        assert found.all() or own.coded(found) == data


@pytest.mark.parametrize("data", [b"\xff" * 9, bytes(9), b"\0\0"])
def test_bytes_that_no_choice_has_are_refused(data: bytes) -> None:
    with pytest.raises(BitstreamError, match="range-coded data"):
        Areas((8, 8)).decoded(data)


def test_choices_of_areas_together_are_short() -> None:
    own = Areas((4 * 36, 4 * 44))
    assert own.shape == (36, 44)
    assert own.coded(np.ones(own.count, bool)) == b""
    assert 0 < 8 * len(own.coded(np.zeros(own.count, bool))) < 0.1 * own.count
    rng = np.random.default_rng(2)
    for _ in range(5):
        assert 8 * len(own.coded(clustered(own.shape, rng))) < 0.35 * own.count
    scattered = rng.random(own.count) < 0.5
    assert 8 * len(own.coded(scattered)) < 1.05 * own.count + 16


def plain_context(flags: np.ndarray, row: int, column: int) -> int:
    """Return the context of an area: which of those left, above, and to the right of that are chosen."""
    padded = np.pad(flags, 1)
    left, above, beside = padded[row + 1, column], padded[row, column + 1], padded[row, column + 2]
    return int(left) + 2 * int(above) + 4 * int(beside)


@pytest.mark.nojit
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (6, 1), (9, 11)])
def test_areas_are_coded_by_those_before_them(choose: Choose, shape: tuple[int, int]) -> None:
    """Compiled and as Python: bytes come back, and contexts have counted what the plain way finds."""
    flags = (np.random.default_rng(3).random(shape) < 0.4).astype(np.uint8)
    flags[-1, -1] = 0  # all would take no bytes
    expected = areas._new_counts()
    for row, column in np.ndindex(shape):
        expected[plain_context(flags, row, column), flags[row, column]] += 16
    kernel = choose(_kernels.code_areas)
    writer, counts, written = RangeCoder.writer(), areas._new_counts(), flags.copy()
    kernel(writer.room_for(flags.size), counts, written)
    data = writer.to_bytes(shortest=True)
    np.testing.assert_array_equal(written, flags)
    np.testing.assert_array_equal(counts, expected)
    assert data == Areas((SIDE * shape[0], SIDE * shape[1])).coded(flags.astype(bool).ravel())
    reader, counts, read = RangeCoder.reader(data), areas._new_counts(), 1 - flags
    kernel(reader.room_for(flags.size), counts, read)
    reader.check_end(data)
    np.testing.assert_array_equal(read, flags)
    np.testing.assert_array_equal(counts, expected)
