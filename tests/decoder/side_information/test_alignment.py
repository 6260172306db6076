"""Block motion after the motion of the whole frame."""

import numpy as np
import pytest

from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.protocol import ReferenceFrame
from decoder.side_information.track_interpolation import aligned_block_motion, warp_frame, whole_frame_motion
from dvc.metrics import psnr_db
from dvc.video import Frame
from dvc.wynerziv.transform import to_uint8
from tests.scenes_3d import texture

TILT = np.array([[1.02, 0.03, -4.0], [-0.02, 0.99, 3.0], [1e-4, -5e-5, 1.0]])


def mapped(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return points where a homography takes them."""
    image = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return image[:, :2] / image[:, 2:]


def points(number: int, seed: int = 0) -> np.ndarray:
    """Return points of a QCIF frame."""
    return np.random.default_rng(seed).uniform([0, 0], [175, 143], (number, 2))


def test_a_homography_is_found_in_spite_of_outliers() -> None:
    first = points(80)
    second = np.round(mapped(TILT, first))
    second[:20] += 15.0
    second[20:25] = np.nan
    found = whole_frame_motion(first, second)
    residuals_px = np.hypot(*(mapped(found, first) - second).T)
    grid = points(50, seed=1)
    assert np.abs(mapped(found, grid) - mapped(TILT, grid)).max() < 0.6
    assert residuals_px[:20].min() > 10.0
    assert np.median(residuals_px[25:]) < 0.6


@pytest.mark.parametrize("number", [0, 1, 2, 5, 6, 9])
def test_few_points_give_less_than_a_homography(number: int) -> None:
    first = points(number)
    found = whole_frame_motion(first, first + np.array([7.0, -2.0]))
    expected = np.eye(3) if number == 0 else np.array([[1.0, 0, 7.0], [0, 1.0, -2.0], [0, 0, 1.0]])
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("kind", ["one place", "line", "noise", "turned over", "all to one place"])
def test_hostile_points_give_a_sane_map(kind: str) -> None:
    first = points(60)
    second = points(60, seed=2)
    if kind == "one place":
        first[:] = 40.0
    if kind == "line":
        first[:, 1] = 30.0
    if kind == "turned over":
        second = first * [-1.0, 1.0] + [175.0, 0.0]
    if kind == "all to one place":
        second[:] = 20.0
    found = whole_frame_motion(first, second)
    corners = mapped(found, np.array([[0.0, 0.0], [175.0, 0.0], [0.0, 143.0]]))
    assert np.isfinite(corners).all()
    across, down = corners[1] - corners[0], corners[2] - corners[0]
    assert across[0] * down[1] - across[1] * down[0] > 0


def test_chroma_moves_with_luma() -> None:
    rng = np.random.default_rng(0)
    planes = [rng.integers(0, 255, shape).astype(np.uint8) for shape in ((40, 60), (20, 30), (20, 30))]
    shift = np.array([[1.0, 0.0, 6.0], [0.0, 1.0, 4.0], [0.0, 0.0, 1.0]])
    warped = warp_frame(Frame(planes[0], (planes[1], planes[2])), shift)
    np.testing.assert_array_equal(warped.luma[:-4, :-6], planes[0][4:, 6:])
    assert warped.chroma is not None
    np.testing.assert_array_equal(warped.chroma[1][:-2, :-3], planes[2][2:, 3:])
    assert warp_frame(Frame(planes[0], None), shift).chroma is None


def test_uneven_motion_is_followed() -> None:
    rows, columns = np.indices((144, 176)).astype(np.float64)
    places = [(0.0, 0.0), (9.0, -5.0), (2.0, 1.0)]
    frames = [Frame(to_uint8(texture((columns + x) / 80, (rows + y) / 80, 0)), None) for x, y in places]
    around = ReferenceFrame(0, frames[0]), ReferenceFrame(2, frames[2])
    first = points(40)
    seen = tuple(first - np.array(place) for place in places)
    aligned = aligned_block_motion(around, 1, (seen[0], seen[1], seen[2]))
    [plain] = BlockMotionInterpolation().predict(around, None, [1])
    inner = np.s_[12:-12, 12:-12]
    gain = [psnr_db(to_uint8(p.luma)[inner], frames[1].luma[inner]) for p in (aligned, plain)]
    assert gain[0] > gain[1] + 6.0
