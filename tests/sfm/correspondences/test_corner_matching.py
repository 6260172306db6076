"""Matching of corners: right pairs, one to one, and frames that have none in common."""

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.arrays import Bytes
from sfm.correspondences import corner_matching
from sfm.correspondences.corner_matching import (
    best_candidates,
    chi_square,
    describe,
    detect_corners,
    match_corners,
)
from sfm.scene_model import Correspondences
from tests.reference import sfm_matching as reference
from tests.sfm.textures import picture, shifted, texture

HEIGHT, WIDTH = 144, 176
TEXTURE = texture(11)


def matched(a: Bytes, b: Bytes) -> Correspondences:
    """Detect and match."""
    return match_corners(a, b, detect_corners(a, 200), detect_corners(b, 200))


def test_a_shift_is_found() -> None:
    """Most corners are matched, all within 0.1 px, at the corners of the first frame."""
    a, b = picture(TEXTURE, HEIGHT, WIDTH), shifted(TEXTURE, HEIGHT, WIDTH, (11.3, -6.6))
    found = matched(a, b)
    assert len(found) > 80
    assert np.abs(found.motion - [11.3, -6.6]).max() < 0.1
    assert {tuple(p) for p in found.first} <= {tuple(p) for p in detect_corners(a, 200)}
    assert (found.error < 2.0).all()


def test_exposure_may_drift() -> None:
    """A second frame of less contrast and brightness gives nearly as many matches."""
    a, b = picture(TEXTURE, HEIGHT, WIDTH), shifted(TEXTURE, HEIGHT, WIDTH, (4.2, 3.1))
    darker = np.rint(b * 0.93).astype(np.uint8)
    found = matched(a, darker)
    assert len(found) > 0.7 * len(matched(a, b))
    assert np.abs(found.motion - [4.2, 3.1]).max() < 0.15


def test_points_are_used_once() -> None:
    """No corner of either frame is in two correspondences."""
    a, b = picture(TEXTURE, HEIGHT, WIDTH), shifted(TEXTURE, HEIGHT, WIDTH, (2.5, 2.5))
    found = matched(a, b)
    assert len(np.unique(found.first, axis=0)) == len(found)
    gap = np.sqrt(((found.second[:, None] - found.second) ** 2).sum(axis=2)) + 9.0 * np.eye(len(found))
    assert gap.min() > 0.5


def test_motion_is_bounded() -> None:
    """Nothing is matched if the true motion is beyond a quarter of the frame's width."""
    a = picture(TEXTURE, HEIGHT, WIDTH)
    assert len(matched(a, shifted(TEXTURE, HEIGHT, WIDTH, (42.0, 0.0)))) > 40
    assert len(matched(a, shifted(TEXTURE, HEIGHT, WIDTH, (46.0, 0.0)))) <= 3


def test_repeated_structure_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a pattern that repeats within the motion bound nothing is matched: any match would be a guess."""
    tile = picture(texture(12), 24, 24)
    wall = np.tile(tile, (6, 8))
    assert len(matched(wall, wall)) <= 3
    monkeypatch.setattr(corner_matching, "MAX_AMBIGUITY", 10.0)
    assert len(matched(wall, wall)) > 40


@pytest.mark.parametrize(
    "pair",
    [
        (np.zeros((64, 64)), np.zeros((64, 64))),
        (np.full((16, 16), 200), np.full((16, 16), 10)),
        (np.zeros((64, 64)), np.random.default_rng(1).integers(0, 256, (64, 64))),
    ],
)
def test_frames_without_corners(pair: tuple[np.ndarray, np.ndarray]) -> None:
    """Black, flat and tiny frames give no correspondences."""
    a, b = (image.astype(np.uint8) for image in pair)
    found = matched(a, b)
    assert len(found) == 0
    assert found.first.shape == found.second.shape == (0, 2)


def test_noise_is_not_matched() -> None:
    """Two frames of independent noise have next to nothing in common; one has everything with itself."""
    a, b = np.random.default_rng(2).integers(0, 256, (2, 128, 128), dtype=np.uint8)
    assert len(matched(a, b)) <= 2
    same = matched(a, a)
    assert len(same) > 150
    np.testing.assert_allclose(same.motion, 0.0, atol=1e-9)


def test_wrong_arguments_are_refused() -> None:
    """Frames of different size raise ValueError."""
    a = picture(TEXTURE, 64, 64)
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
@pytest.mark.parametrize("compiled", [True, False])
def test_chi_square(compiled: bool) -> None:
    """The distance of two distributions is that of the twin; without overlap it is the number of samples."""
    chi = chi_square if compiled else python_twin(chi_square)
    a, b = np.random.default_rng(3).uniform(0.0, 9.0, (2, 8))
    assert chi(a, b) == pytest.approx(reference.chi_square(a, b))
    assert chi(np.array([3.0, 0.0, 0.0]), np.array([0.0, 3.0, 0.0])) == pytest.approx(3.0)


@pytest.mark.nojit
@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("count", [1, 3])
def test_best_candidates(compiled: bool, count: int) -> None:
    """The most similar corners that pass every test are listed in order, as the twin finds them."""
    rng = np.random.default_rng(4)
    corners = [rng.integers(10, 60, (25, 2)).astype(np.float64) for _ in range(2)]
    luma = picture(TEXTURE, 70, 70)
    first, second = (describe(luma, points) for points in corners)
    limits = rng.uniform(3e4, 2e5, 25)
    chosen, errors = np.full((25, count), -1), np.empty((25, count))
    kernel = best_candidates if compiled else python_twin(best_candidates)
    tests = (30.0, 60.0, limits)
    kernel(first, second, 30.0, *tests[:2], limits, chosen, errors)
    expected, least = reference.best_candidates(
        *corners, 30.0, *zip(first[1:], second[1:], strict=True), *tests, count
    )
    assert [[j for j in row if j >= 0] for row in chosen.tolist()] == expected
    assert any(expected)
    for row, found in zip(errors, least, strict=True):
        np.testing.assert_allclose(row[: len(found)], found)
