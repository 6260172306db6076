"""Pairs of plain photographs: their choice, counted pixels, and the table of a rendered clip."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.plain_pairs import (
    COLOUR_K,
    Clip,
    Pair,
    _from_the_left,
    _to_the_left,
    close_percent,
    in_space,
    main,
    pixels,
    possible_pairs,
    seen_by_both,
    spread,
)

DEPTH_M, STEP_M = 2.0, 0.02


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write pictures of a textured wall and a box before it, by a camera that moves to the right."""
    folder = tmp_path_factory.mktemp("clip")
    for name in ("color", "depth", "pose"):
        (folder / name).mkdir()
    np.savetxt(folder / "intrinsics.txt", [[585.0, 0, 320], [0, 585, 240], [0, 0, 1]])
    rng = np.random.default_rng(0)
    coarse = (rng.integers(0, 256, (size, size, 3)).astype(np.uint8) for size in (260, 220))
    wall, box = (cv2.resize(texture, (1600, 1600)) for texture in coarse)
    y, x = np.mgrid[:480, :640]
    for k in range(24):
        where = np.eye(4)
        where[0, 3] = STEP_M * k
        np.savetxt(folder / "pose" / f"{k:06d}.txt", where)
        picture = np.zeros((480, 640, 3), np.uint8)
        for texture, depth, half in ((wall, DEPTH_M, 9.0), (box, 0.7 * DEPTH_M, 0.25)):
            u, v = (x - 325.5) / 528.0 * depth + STEP_M * k, (y - 241.3) / 528.0 * depth
            inside = (abs(u - 0.1) < half) & (abs(v) < half)
            place = [(400.0 * axis + 800.0).astype(np.float32) for axis in (u, v)]
            picture[inside] = cv2.remap(texture, *place, cv2.INTER_LINEAR)[inside]
        cv2.imwrite(str(folder / "color" / f"{k:06d}.jpg"), picture)
        if k % 8 == 0:
            u, v = (x - 320) / 585.0 * 0.7 * DEPTH_M + STEP_M * k, (y - 240) / 585.0 * 0.7 * DEPTH_M
            depth = np.where((abs(u - 0.1) < 0.25) & (abs(v) < 0.25), 0.7 * DEPTH_M, DEPTH_M)
            depth[:, :20] = 0.0
            cv2.imwrite(str(folder / "depth" / f"{k:06d}.png"), np.rint(1000 * depth).astype(np.uint16))
    return folder


def test_pairs_are_a_tenth_of_the_depth_apart(folder: Path) -> None:
    """Every photograph with depth has one partner; two in a row of three are the first and the second."""
    pairs = possible_pairs(Clip(folder))
    assert [pair.first for pair in pairs] == [0, 8, 16]
    for pair in pairs:
        assert STEP_M * abs(pair.second - pair.first) / DEPTH_M == pytest.approx(pair.ratio, rel=0.1)
        assert pair.ratio == pytest.approx(0.1, abs=0.01)
    assert spread(pairs, 2) == pairs[:2]
    assert spread(pairs, 9) == [*pairs]


def test_depth_is_that_of_the_photograph(folder: Path) -> None:
    """Next to the camera of the depth, a wall is as far away; unmeasured depth is unknown."""
    clip = Clip(folder)
    depth = clip.depth(8)
    known = np.isfinite(depth)
    assert 0.6 < known.mean() < 0.9
    near = np.minimum(abs(depth - DEPTH_M), abs(depth - 0.7 * DEPTH_M))[known]
    assert near.max() < 0.03 * DEPTH_M
    both = seen_by_both(clip, Pair(8, 18, 0.1), depth)
    assert not both[~known].any()
    assert 0.7 < both[known].mean() < 0.98


def test_points_come_back_to_their_pixels() -> None:
    """Projection is the inverse of back-projection; points behind the camera are not inside."""
    depth = np.full((480, 640), np.inf)
    depth[[3, 200], [7, 600]] = 1.5, 4.0
    points = in_space(depth, COLOUR_K)
    x, y, inside = pixels(np.concatenate([points, -points]), depth.shape)
    assert [*zip(x[:2], y[:2], strict=True)] == [(7, 3), (600, 200)]
    assert inside.tolist() == [True, True, False, False]


def test_depth_counts_in_one_scale() -> None:
    truth = np.array([[2.0, 4.0, 6.0, 8.0, np.inf, 10.0]])
    depth = 0.5 * truth * [1.0, 1.04, 1.1, 1.0, 1.0, np.nan]
    both = np.array([[True, True, True, False, True, False]])
    assert close_percent(depth, truth, both) == pytest.approx((60.0, 200.0 / 3.0))


@pytest.mark.parametrize("step", [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
def test_first_view_is_turned_to_the_left_and_back(step: tuple[float, float]) -> None:
    """The second shows a point farther to the left by its disparity, for pairs in any direction."""
    place, picture = np.array([20, 30]), np.zeros((2, 50, 60, 3), np.uint8)
    picture[0, place[1], place[0]] = picture[1, place[1] - int(4 * step[1]), place[0] - int(4 * step[0])] = (
        255
    )
    first, second = (_to_the_left(one, np.array(step))[:, :, 0] for one in picture)
    assert np.subtract(np.argwhere(first), np.argwhere(second)).tolist() == [[0, 4]]
    back = _from_the_left(first.astype(np.float32), np.array(step))
    np.testing.assert_array_equal(back, picture[0, :, :, 0])


@pytest.mark.slow
def test_table_of_a_pair(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The commands find a wall and a box in textured photographs; the table and the figures show it."""
    file = tmp_path / "figures.json"
    assert main([str(folder), "--pairs", "1", "--json", str(file)]) == 0
    (figures,) = json.loads(file.read_text())
    assert figures["pair"] == [0, 10]
    assert figures["close_percent"][1] > 75.0
    assert figures["row_rms_px"] < 1.0
    assert figures["growth"] < 1.3
    table = capsys.readouterr().out.splitlines()
    assert table[1].split()[:2] == ["pair", "ratio"]
    assert [line.split()[0] for line in table[2:]] == ["0", "even", "all"]


def test_folders_without_a_pair_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line, exit status 2."""
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path)])
    assert ended.value.code == 2
    assert capsys.readouterr().err == (f"{tmp_path}: not a clip with poses, depth and intrinsics.txt\n")
