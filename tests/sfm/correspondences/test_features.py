"""Corners: where they are, how they spread, and frames without any."""

import cv2
import numpy as np
import pytest

from dvc._jit import python_twin
from sfm.correspondences.corner_matching import detect_corners, suppression_radii
from tests.reference import sfm_matching as reference
from tests.sfm.textures import picture, texture


def test_corners_of_a_square_are_found() -> None:
    """The four corners of a bright square are corners, and nothing else is."""
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
    """Black, white and tiny frames give an empty array."""
    assert detect_corners(np.full(shape, level, dtype=np.uint8)).shape == (0, 2)


def test_the_number_of_threads_does_not_matter() -> None:
    """OpenCV's threads share the rows, not the sums."""
    luma = np.random.default_rng(5).integers(0, 256, (288, 352), dtype=np.uint8)
    before = cv2.getNumThreads()
    found = []
    for threads in (1, 4):
        cv2.setNumThreads(threads)
        found.append(detect_corners(luma))
    cv2.setNumThreads(before)
    np.testing.assert_array_equal(*found)


@pytest.mark.nojit
@pytest.mark.parametrize("compiled", [True, False])
def test_suppression_radii(compiled: bool) -> None:
    """Each maximum is as far from the nearest clearly stronger one as its twin says."""
    rng = np.random.default_rng(6)
    points = rng.integers(0, 30, (40, 2))
    strength = np.sort(rng.integers(1, 12, 40).astype(np.float64))[::-1].copy()
    radii = np.empty(40, dtype=np.int64)
    kernel = suppression_radii if compiled else python_twin(suppression_radii)
    kernel(points[:, 0].copy(), points[:, 1].copy(), strength, 0.9, radii)
    assert radii.tolist() == reference.suppression_radii(points, strength, 0.9)


def test_wrong_arguments_are_refused() -> None:
    """Frames that are no planes of bytes raise ValueError."""
    with pytest.raises(ValueError, match="uint8"):
        detect_corners(np.zeros((20, 20)))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="shape"):
        detect_corners(np.zeros((20, 20, 3), dtype=np.uint8))
