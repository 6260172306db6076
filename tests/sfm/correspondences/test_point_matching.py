"""Corners, their matches one to one, and more of them where motion and epipolar geometry expect them."""

import cv2
import numpy as np
import pytest

from dvc.arrays import Bytes
from sfm.correspondences import point_matching
from sfm.correspondences.epipolar_search import EpipolarSearch
from sfm.correspondences.point_matching import (
    best_candidates,
    chi_square,
    densify,
    describe,
    detect_corners,
    match_corners,
    neighbourhood_variances,
    suppression_radii,
)
from sfm.scene_model import Correspondences
from tests.reference import sfm_matching as reference
from tests.sfm.textures import picture, shifted, sideways, texture
from tests.twins import Choose

HEIGHT, WIDTH = 144, 176
TEXTURE = texture(11)
WAVES = texture(31, 6.0, 20.0, 30.0)
A = picture(WAVES, 120, 160)
B = shifted(WAVES, 120, 160, (7.3, 0.0))
SEARCH = EpipolarSearch(A, B, sideways())
CORNERS = detect_corners(A, 200), detect_corners(B, 200)


def test_corners_of_a_square_are_found() -> None:
    luma = np.full((60, 80), 50, dtype=np.uint8)
    luma[20:40, 25:55] = 200
    found = detect_corners(luma)
    expected = np.array([[25, 20], [54, 20], [25, 39], [54, 39]])
    distance = np.abs(found[:, None] - expected).max(axis=2)
    assert (distance.min(axis=0) <= 1).all()
    assert (distance.min(axis=1) <= 2).all()


def test_weak_texture_gets_its_corners() -> None:
    """With one half of the frame at a tenth of the contrast, both halves have similar numbers of corners."""
    y, x = np.mgrid[:144, :176].astype(np.float64)
    wave = texture(3, contrast=60.0)(x, y) - 128.0
    luma = np.clip(128 + wave * np.where(x < 88, 0.1, 1.0), 0, 255).astype(np.uint8)
    corners = detect_corners(luma, 120)
    left = np.count_nonzero(corners[:, 0] < 88)
    assert len(corners) == 120
    assert 40 <= left <= 80


def test_fewer_corners_are_a_prefix() -> None:
    """The best spread corners come first, so that asking for fewer leaves out the last ones."""
    luma = picture(texture(4), 96, 128)
    many, few = (detect_corners(luma, n) for n in (60, 20))
    np.testing.assert_array_equal(many[:20], few)
    assert len(np.unique(many, axis=0)) == len(many)
    assert (many >= 8).all()
    assert (many <= [119, 87]).all()


@pytest.mark.parametrize("shape", [(16, 16), (1, 40), (2, 2), (288, 352)])
@pytest.mark.parametrize("level", [0, 255])
def test_flat_and_tiny_frames_have_none(shape: tuple[int, int], level: int) -> None:
    assert detect_corners(np.full(shape, level, dtype=np.uint8)).shape == (0, 2)


def test_the_number_of_threads_does_not_matter() -> None:
    luma = np.random.default_rng(5).integers(0, 256, (288, 352), dtype=np.uint8)
    before = cv2.getNumThreads()
    found = []
    for threads in (1, 4):
        cv2.setNumThreads(threads)
        found.append(detect_corners(luma))
    cv2.setNumThreads(before)
    np.testing.assert_array_equal(*found)


@pytest.mark.nojit
def test_suppression_radii(choose: Choose) -> None:
    rng = np.random.default_rng(6)
    points = rng.integers(0, 30, (40, 2))
    strength = np.sort(rng.integers(1, 12, 40).astype(np.float64))[::-1].copy()
    radii = np.empty(40, dtype=np.int64)
    kernel = choose(suppression_radii)
    kernel(points[:, 0].copy(), points[:, 1].copy(), strength, radii)
    assert radii.tolist() == reference.suppression_radii(points, strength, 0.9)


def matched(a: Bytes, b: Bytes) -> Correspondences:
    """Detect and match."""
    return match_corners(a, b, detect_corners(a, 200), detect_corners(b, 200))


def test_a_shift_is_found() -> None:
    """Most corners are matched once, within 0.1 px, at the corners of the first frame."""
    a, b = picture(TEXTURE, HEIGHT, WIDTH), shifted(TEXTURE, HEIGHT, WIDTH, (11.3, -6.6))
    found = matched(a, b)
    assert len(found) > 80
    assert np.abs(found.motion - [11.3, -6.6]).max() < 0.1
    assert {tuple(p) for p in found.first} <= {tuple(p) for p in detect_corners(a, 200)}
    assert (found.error < 2.0).all()
    assert len(np.unique(found.first, axis=0)) == len(found)
    gap = np.sqrt(((found.second[:, None] - found.second) ** 2).sum(axis=2)) + 9.0 * np.eye(len(found))
    assert gap.min() > 0.5
    # A second frame of less contrast and brightness gives nearly as many matches.
    drifted = matched(a, np.rint(b * 0.93).astype(np.uint8))
    assert len(drifted) > 0.7 * len(found)
    assert np.abs(drifted.motion - [11.3, -6.6]).max() < 0.15


def test_motion_is_bounded() -> None:
    a = picture(TEXTURE, HEIGHT, WIDTH)
    assert len(matched(a, shifted(TEXTURE, HEIGHT, WIDTH, (42.0, 0.0)))) > 40
    assert len(matched(a, shifted(TEXTURE, HEIGHT, WIDTH, (46.0, 0.0)))) <= 3


def test_repeated_structure_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a pattern that repeats within the motion bound nothing is matched: any match would be a guess."""
    tile = picture(texture(12), 24, 24)
    wall = np.tile(tile, (6, 8))
    assert len(matched(wall, wall)) <= 3
    monkeypatch.setattr(point_matching, "MAX_AMBIGUITY", 10.0)
    assert len(matched(wall, wall)) > 40


@pytest.mark.parametrize(
    "pair",
    [
        (np.zeros((64, 64)), np.zeros((64, 64))),
        (np.full((16, 16), 200), np.full((16, 16), 10)),
        (np.zeros((64, 64)), np.random.default_rng(1).integers(0, 256, (64, 64))),
    ],
)
def test_frames_without_common_corners(pair: tuple[np.ndarray, np.ndarray]) -> None:
    a, b = (image.astype(np.uint8) for image in pair)
    found = matched(a, b)
    assert len(found) == 0
    assert found.first.shape == found.second.shape == (0, 2)
    # Two frames of independent noise have next to nothing in common; one has everything with itself.
    a, b = np.random.default_rng(2).integers(0, 256, (2, 128, 128), dtype=np.uint8)
    assert len(matched(a, b)) <= 2
    same = matched(a, a)
    assert len(same) > 150
    np.testing.assert_allclose(same.motion, 0.0, atol=1e-9)


def test_wrong_arguments_are_refused() -> None:
    a = picture(TEXTURE, 64, 64)
    for wrong in (a.astype(float), np.stack([a] * 3, axis=2)):
        with pytest.raises(ValueError, match="uint8"):
            detect_corners(wrong)
    with pytest.raises(ValueError, match="one shape"):
        match_corners(a, a[1:], np.empty((0, 2)), np.empty((0, 2)))


def test_histograms() -> None:
    """Triangular windows are summed as the twin does, beyond the outermost bins as well."""
    rng = np.random.default_rng(3)
    luma = rng.integers(0, 256, (17, 17)).astype(np.uint8)
    corners = np.array([[6.0, 6.0], [8.0, 9.0], [10.0, 7.0]])
    described = describe(luma, corners)
    deviations = described.patches - described.means[:, None]
    expected = [reference.parzen_histogram(patch, 12.0, 16) for patch in deviations]
    np.testing.assert_allclose(described.histograms, expected, atol=1e-9)
    np.testing.assert_allclose(described.histograms.sum(axis=1), 169.0)


@pytest.mark.nojit
def test_chi_square(choose: Choose) -> None:
    """The distance of two distributions is that of the twin; without overlap it is the number of samples."""
    chi = choose(chi_square)
    a, b = np.random.default_rng(3).uniform(0.0, 9.0, (2, 8))
    assert chi(a, b) == pytest.approx(reference.chi_square(a, b))
    assert chi(np.array([3.0, 0.0, 0.0]), np.array([0.0, 3.0, 0.0])) == pytest.approx(3.0)


@pytest.mark.nojit
@pytest.mark.parametrize("count", [1, 3])
def test_best_candidates(choose: Choose, count: int) -> None:
    """The most similar corners that pass every test are listed in order, as the twin finds them."""
    rng = np.random.default_rng(4)
    corners = [rng.integers(10, 60, (25, 2)).astype(np.float64) for _ in range(2)]
    luma = picture(TEXTURE, 70, 70)
    first, second = (describe(luma, points) for points in corners)
    limits = rng.uniform(3e4, 2e5, 25)
    chosen, errors = np.full((25, count), -1), np.empty((25, count))
    kernel = choose(best_candidates)
    kernel(first, second, 30.0, limits, chosen, errors)
    tests = (point_matching.MAX_BRIGHTNESS_CHANGE, point_matching.MAX_CHI_SQUARE_SHARE * 169, limits)
    expected, least = reference.best_candidates(
        *corners, 30.0, *zip(first[1:], second[1:], strict=True), *tests, count
    )
    assert [[j for j in row if j >= 0] for row in chosen.tolist()] == expected
    assert any(expected)
    for row, found in zip(errors, least, strict=True):
        np.testing.assert_allclose(row[: len(found)], found)


def test_left_out_corners_come_back() -> None:
    """From every fifth match most others are found again, all but a few right; the given come first."""
    matches = match_corners(A, B, *CORNERS)
    matches = matches[np.abs(matches.motion - [7.3, 0.0]).max(axis=1) < 0.15]
    given = matches[np.arange(0, len(matches), 5)]
    found = densify(SEARCH, *CORNERS, given)
    np.testing.assert_array_equal(found.first[: len(given)], given.first)
    assert len(found) > 0.75 * len(matches)
    assert (np.abs(found.motion - [7.3, 0.0]).max(axis=1) < 0.15).mean() > 0.98


def test_nothing_to_go_by() -> None:
    matches = match_corners(A, B, *CORNERS)
    few, fifth = matches[np.arange(3)], matches[np.arange(0, len(matches), 5)]
    assert densify(SEARCH, *CORNERS, few) is few
    assert len(densify(EpipolarSearch(A, B, sideways((0.0, 1.0))), *CORNERS, fifth)) == len(fifth)
    assert densify(EpipolarSearch(A, B, np.zeros((3, 3))), *CORNERS, matches) is matches
    none = np.empty((0, 2))
    assert densify(SEARCH, none, CORNERS[1], matches) is matches
    assert densify(SEARCH, CORNERS[0], none, matches) is matches
    flat = np.full((120, 160), 9, dtype=np.uint8)
    assert len(densify(EpipolarSearch(flat, flat, sideways()), *CORNERS, matches)) == len(matches)
    assert len(densify(SEARCH, *CORNERS, Correspondences.empty())) == 0


def test_variances_are_of_squares_around_points() -> None:
    points = np.array([[20.0, 30.0], [3.0, 3.0], [2.0, 60.0], [156.0, 116.0], [50.0, 117.0]])
    found = neighbourhood_variances(A, points, 3)
    squares = [A[int(y) - 3 : int(y) + 4, int(x) - 3 : int(x) + 4].astype(np.float64) for x, y in points]
    expected = [square.var() if square.shape == (7, 7) else 0.0 for square in squares]
    assert np.count_nonzero(expected) == 3
    np.testing.assert_allclose(found, expected)
