"""Searches for a block against their plain twins."""

import numpy as np
import pytest

from encoder import _kernels
from encoder.point_tracker import spiral
from tests.clips import moving_texture
from tests.reference import block_matching as reference
from tests.twins import Choose

STILL_LIFE = moving_texture(1, 120, 160)[0].luma


def test_spiral_starts_at_rest_and_grows() -> None:
    displacements = spiral(3)
    assert displacements[0].tolist() == [0, 0]
    assert len({tuple(d) for d in displacements.tolist()}) == 49
    assert (np.diff(np.hypot(*displacements.T)) >= -1e-12).all()


@pytest.mark.parametrize("half", [4, 5, 7])
def test_sums_of_absolute_differences(half: int, choose: Choose) -> None:
    """All samples of a block are compared once, up to the largest differences; not off the image."""
    sad = choose(_kernels.block_sad)
    rng = np.random.default_rng(half)
    side = 2 * half + 1
    blocks = rng.integers(0, 256, (3, side, side)).astype(np.uint8)
    blocks[1] = 255
    image = rng.integers(0, 256, (side + 6, side + 9)).astype(np.uint8)
    image[:, -side:] = 0
    counts, num_blocks = np.zeros(2, np.int64), 0
    for y in range(half - 2, image.shape[0] - half + 2):
        for x in range(half - 2, image.shape[1] - half + 2):
            for i in range(3):
                expected = reference.sad(image, x, y, blocks[i])
                num_blocks += expected is not None
                found = sad(_kernels.Matching(image, blocks, counts), x, y, half, i)
                assert found == (_kernels.UNKNOWN if expected is None else expected)
    assert counts.tolist() == [num_blocks, num_blocks * side**2]


@pytest.mark.parametrize("seed", range(3))
def test_searches_agree_with_the_twin(seed: int, choose: Choose) -> None:
    """Spiral and descent find what the plain twins find, and know the neighbours of a minimum."""
    rng = np.random.default_rng(seed)
    image, half = STILL_LIFE[:60, :64], _kernels.HALF_BLOCK_PX
    for _ in range(15):
        x, y = (int(c) for c in rng.integers(half, [64 - half, 60 - half]))
        if rng.random() < 0.3:
            x, y = 90, 80
        block = STILL_LIFE[y - half : y + half + 1, x - half : x + half + 1]
        blocks = np.stack([block, 255 - block, block])
        at = x + int(rng.integers(-4, 5)), y + int(rng.integers(-4, 5))
        counts, around = np.zeros(2, np.int64), np.empty(8, np.int64)
        small = int(rng.integers(0, 800))
        matching = _kernels.Matching(image, blocks, counts)
        found = choose(_kernels.spiral_search)(matching, *at, half, 2, small, spiral(4))
        expected = reference.spiral_search(image, *at, block, small, spiral(4))
        assert found == (expected if expected[2] is not None else (*expected[:2], _kernels.UNKNOWN))
        assert counts[0] <= 81
        if expected[2] is None:
            continue
        went = choose(_kernels.descend)(matching, *found[:2], 2, found[2], 50, around)
        assert went == reference.descend(image, *expected[:2], block, 50)
        neighbours = [(went[0] + dx, went[1] + dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dx or dy]
        sads = [reference.sad(image, *place, block) for place in neighbours]
        assert around.tolist() == [_kernels.UNKNOWN if value is None else value for value in sads]


@pytest.mark.parametrize("max_steps", [0, 1, 3])
def test_descents_stop_in_time(max_steps: int) -> None:
    """After so many steps the neighbours of where the search stands are known, minimum or not."""
    image, half = np.add.outer(3 * np.arange(40), 2 * np.arange(40)).astype(np.uint8), _kernels.HALF_BLOCK_PX
    blocks = image[None, 10 - half : 11 + half, 10 - half : 11 + half].copy()
    start = reference.sad(image, 20, 20, blocks[0])
    around = np.empty(8, np.int64)
    counts = np.zeros(2, np.int64)
    x, y, sad = _kernels.descend(
        _kernels.Matching(image, blocks, counts), 20, 20, 0, start, max_steps, around
    )
    assert (x, y, sad) == reference.descend(image, 20, 20, blocks[0], max_steps) == (x, 20 - max_steps, sad)
    assert around[1] == reference.sad(image, x, y - 1, blocks[0])
    assert counts[0] == 8 * (max_steps + 1)


@pytest.mark.parametrize("seed", range(3))
def test_points_follow_the_nearest_that_is_found(seed: int, choose: Choose) -> None:
    offer = choose(_kernels.offer_motion)
    rng = np.random.default_rng(seed)
    first = rng.integers(0, [6, 16384], (30, 2))
    found, nearest = np.zeros(30, np.bool_), np.full(30, _kernels.UNKNOWN << 20)
    x, y = (np.ascontiguousarray(component, np.int32) for component in first.T)
    for j in rng.permutation(30)[:12].tolist():
        found[j] = True
        offer(x, y, j, 0, nearest)
        expected = [reference.nearest_found(first, found, i) for i in range(30)]
        assert (nearest & (1 << 20) - 1).tolist() == expected


@pytest.mark.parametrize("scale", [1.0, 2.0, 8.0])
def test_frames_are_finished_as_their_twin_says(scale: float, choose: Choose) -> None:
    finish = choose(_kernels.finish_frame)
    rng = np.random.default_rng(int(scale))
    first, last, position = (rng.integers(0, 100, (40, 2)) for _ in range(3))
    small, sads = rng.integers(50, 60, 40), rng.integers(0, 12, 40)
    beside, found = rng.integers(8, 16, (40, 4)), rng.random(40) < 0.7
    velocity, path = np.empty((40, 2), np.int64), np.empty((40, 2))
    points, search = _kernels.Points(first, small), _kernels.Matches(position, sads, beside, found)
    longest = finish(points, last, search, scale, velocity, path)
    assert np.array_equal(velocity, position - last)
    assert longest == ((position - first) ** 2).sum(axis=1)[found].max()
    for i in range(40):
        sides = beside[i].reshape(2, 2).tolist()
        moved = [reference.between_pixels(before, int(sads[i]), after) for before, after in sides]
        offset = np.array(moved) if scale > 1.0 else 0.0
        expected = np.round((position[i] + offset) * scale) / scale if found[i] else [np.nan] * 2
        np.testing.assert_array_equal(path[i], expected)


def test_frames_are_finished_once_enough_points_are_found(choose: Choose) -> None:
    """What was found before is found once more; before that, neither velocities nor paths are written."""
    follow = choose(_kernels.follow)
    points = np.array([[30, 30], [60, 40], [90, 50]])
    blocks, counts = np.zeros((3, 11, 11), np.uint8), np.zeros(2, np.int64)
    _kernels.cut_blocks(STILL_LIFE, points, blocks)
    blocks[2] = 255 - blocks[2]
    matching = _kernels.Matching(STILL_LIFE[3:], blocks, counts)
    movement = _kernels.Movement(points, np.zeros((3, 2), np.int64), np.ones(3, np.bool_))
    search = _kernels.Matches(
        np.zeros((3, 2), np.int64), np.zeros(3, np.int64), np.zeros((3, 4), np.int64), np.zeros(3, np.bool_)
    )
    velocity, path = np.zeros((3, 2), np.int64), np.zeros((3, 2))
    ends = search, 1.0, velocity, path
    given = matching, matching, _kernels.Points(points, np.full(3, 10)), movement, (spiral(5), spiral(5))
    assert follow(*given, 0, 3.0, *ends) == (2, 0)
    assert not velocity.any()
    assert follow(*given, 0, 2.0, *ends) == (2, 9)
    assert velocity[:2].tolist() == [[0, -3], [0, -3]]
    np.testing.assert_array_equal(path, [[30, 27], [60, 37], [np.nan, np.nan]])


@pytest.mark.parametrize("num_ends", [0, 1, 25])
def test_points_that_appear_move_as_the_nearest(num_ends: int, choose: Choose) -> None:
    """The nearest track that reaches the end tells the motion, the first of equals; no lost one does."""
    move = choose(_kernels.move_as_nearest)
    rng = np.random.default_rng(num_ends)
    points, ends = rng.integers(0, 30, (20, 2)), rng.integers(0, 60, (num_ends, 2, 2)) / 2.0
    ends[1::3, 1] = np.nan
    squares, velocity = np.empty(20), np.empty((20, 2), np.int64)
    move(points, ends, squares, velocity)
    expected = [reference.last_motion(point, ends) for point in points]
    assert list(zip(squares.tolist(), velocity.tolist(), strict=True)) == expected
