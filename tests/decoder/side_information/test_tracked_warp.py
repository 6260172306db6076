"""References brought into place by tracked points alone."""

import numpy as np
import pytest
from numpy.typing import NDArray

from decoder.side_information.block_motion.alignment import homography_positions, whole_frame_motion
from decoder.side_information.tracked_warp import warp_by_tracks
from dvc.geometry.sampling import sample
from dvc.metrics import psnr_db
from dvc.wynerziv.transform import to_uint8
from tests.scenes_3d import texture

Floats = NDArray[np.float64]
SHAPE = (144, 176)


def grid() -> Floats:
    """Return (x, y) of every pixel."""
    rows, columns = np.indices(SHAPE)
    return np.stack([columns, rows], axis=-1).astype(np.float64)


def bent(places: Floats) -> Floats:
    """Return where points of the frame are in the reference: a pan, and parallax that no homography takes."""
    x, y = places[..., 0], places[..., 1]
    return np.stack([x + 6.0 + 3.0 * np.sin(y / 25.0), y - 2.0 + 2.0 * np.sin(x / 30.0)], axis=-1)


def scene() -> tuple[NDArray[np.uint8], NDArray[np.uint8], Floats]:
    """Return a reference, the frame, and points of the frame."""
    reference = to_uint8(texture(grid()[..., 0] / 60.0, grid()[..., 1] / 60.0, 0))
    points = np.random.default_rng(3).uniform([8, 8], [168, 136], (120, 2))
    return reference, to_uint8(sample(reference, bent(grid()))), points


def test_residuals_of_tracks_take_what_a_homography_leaves() -> None:
    """Whole-pixel tracks of a bent motion take a third, at least, off what the homography misses by."""
    reference, frame, points = scene()
    warp = warp_by_tracks(reference, points, np.round(bent(points)))
    common = homography_positions(whole_frame_motion(points, np.round(bent(points))), SHAPE)
    off_px, common_px = (
        np.sqrt(((positions - bent(grid())) ** 2).sum(axis=-1))[12:-12, 12:-12].mean()
        for positions in (warp.positions, common)
    )
    assert off_px < min(0.6, common_px / 1.5)
    still_db = psnr_db(frame[12:-12, 12:-12], reference[12:-12, 12:-12])
    assert psnr_db(frame[12:-12, 12:-12], to_uint8(warp.luma)[12:-12, 12:-12]) > still_db + 6.0


def test_what_a_reference_covers_is_told() -> None:
    """After a pan of ten pixels, ten columns lie outside; errors there are expected to be larger."""
    reference, _, points = scene()
    warp = warp_by_tracks(reference, points, points + np.array([10.0, 0.0]))
    np.testing.assert_array_equal(warp.coverage[:, -10:], 0.0)
    np.testing.assert_allclose(warp.coverage[:, :-10], 1.0, atol=1e-6)
    np.testing.assert_allclose(warp.displacement_px, 10.0, atol=1e-6)
    assert warp.expected_error[:, -10:].mean() > 1.5 * warp.expected_error[:, :-10].mean()


@pytest.mark.parametrize("axis", ["motion", "detail"])
def test_errors_grow_with_motion_and_detail(axis: str) -> None:
    """A reference that has hardly moved, and a flat one, are expected to be nearly right."""
    reference, _, points = scene()
    flat = np.full(SHAPE, 90, np.uint8)
    if axis == "motion":
        less, more = (
            warp_by_tracks(reference, points, points + np.array([shift, 0.0])) for shift in (0.0, 8.0)
        )
    else:
        less, more = (
            warp_by_tracks(plane, points, points + np.array([4.0, 0.0])) for plane in (flat, reference)
        )
    assert (more.expected_error >= less.expected_error)[:, :-12].all()
    assert more.expected_error[:, :-12].mean() > 1.2 * less.expected_error[:, :-12].mean()


@pytest.mark.parametrize("known", [0, 1, 2])
def test_few_points_are_enough(known: int) -> None:
    """Without points a reference stays where it is; one or two give a translation."""
    reference, _, points = scene()
    matches = points + np.array([3.0, 1.0])
    matches[known:] = np.nan
    warp = warp_by_tracks(reference, points, matches)
    expected = [0.0, 0.0] if known == 0 else [3.0, 1.0]
    np.testing.assert_allclose(warp.positions - grid(), np.broadcast_to(expected, (*SHAPE, 2)), atol=1e-6)
