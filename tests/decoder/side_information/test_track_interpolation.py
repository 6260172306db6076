"""Frames between two references that tracks alone bring into place."""

import numpy as np
import pytest
from numpy.typing import NDArray

from decoder.side_information.protocol import Interpolation, ReferenceFrame
from decoder.side_information.track_interpolation import (
    aligned_block_motion,
    homography_positions,
    interpolate_by_tracks,
    warp_by_tracks,
    whole_frame_motion,
)
from dvc.geometry.warping import sample
from dvc.metrics import psnr_db
from dvc.video import Frame
from dvc.wynerziv.transform import to_uint8
from tests.scenes_3d import texture

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]
WIDTH, HEIGHT = 176, 144
POINTS = np.random.default_rng(5).uniform([30, 8], [146, 136], (90, 2))


def view(shift_px: float, noise: float = 0.0) -> Luma:
    """Return what a camera sees that has panned so far."""
    rows, columns = np.indices((HEIGHT, WIDTH))
    levels = texture((columns + shift_px) / 60.0, rows / 60.0, 0)
    return to_uint8(levels + np.random.default_rng(1).normal(0.0, noise, levels.shape))


def reference(index: int, luma: Luma) -> ReferenceFrame:
    """Return a reference without chroma."""
    return ReferenceFrame(index, Frame(luma, None))


def predicted(before: Luma, after: Luma, shifts: tuple[float, float]) -> tuple[Interpolation, Luma]:
    """Predict the view of no pan from views of two, and return aligned block motion as well."""
    around = reference(4, before), reference(8, after)
    points = POINTS - [shifts[0], 0.0], POINTS, POINTS - [shifts[1], 0.0]
    old = aligned_block_motion(around, 6, points)
    return interpolate_by_tracks(around, 6, points), to_uint8(old.luma)


def test_what_one_reference_does_not_cover_is_taken_from_the_other() -> None:
    shifts = -24.0, 24.0
    found, old = predicted(view(shifts[0]), view(shifts[1]), shifts)
    wanted = view(0.0)
    assert psnr_db(to_uint8(found.luma), wanted) > psnr_db(old, wanted) + 6.0
    for side in (np.s_[:, :20], np.s_[:, -20:]):
        assert np.abs(found.luma - wanted)[side].mean() < 2.0


def test_a_reference_where_the_camera_paused_is_the_frame() -> None:
    wrong = np.random.default_rng(7).integers(0, 255, (HEIGHT, WIDTH)).astype(np.uint8)
    found, old = predicted(view(0.0), wrong, (0.0, 16.0))
    assert psnr_db(to_uint8(found.luma), view(0.0)) > 34.0
    assert psnr_db(old, view(0.0)) < 25.0


def test_references_of_one_quality_are_averaged() -> None:
    found, _ = predicted(view(-4.0, noise=4.0), view(4.0, noise=4.0), (-4.0, 4.0))
    inside = np.s_[:, 8:-8]
    np.testing.assert_allclose(found.weights[0][inside], 0.5, atol=0.02)
    each = [np.abs(plane - view(0.0))[inside].mean() for plane in found.compensated]
    assert np.abs(found.luma - view(0.0))[inside].mean() < 0.85 * min(each)


def test_the_expected_error_is_larger_where_references_disagree() -> None:
    after = view(4.0)
    after[50:90, 70:110] = 255 - after[50:90, 70:110]
    found, _ = predicted(view(-4.0), after, (-4.0, 4.0))
    patch = np.zeros((HEIGHT, WIDTH), bool)
    patch[58:82, 82:106] = True
    far = np.zeros_like(patch)
    far[:, 8:40] = True
    assert found.expected_error[patch].mean() > 4.0 * found.expected_error[far].mean()


@pytest.mark.parametrize("kind", ["none", "one", "nan", "noise", "far away"])
def test_any_points_give_a_frame(kind: str) -> None:
    points = np.random.default_rng(2).uniform(0, 140, (3, 40, 2))
    if kind == "none":
        points = points[:, :0]
    if kind == "one":
        points = points[:, :1]
    if kind == "nan":
        points[:] = np.nan
    if kind == "far away":
        points[0] += 1e6
    around = reference(0, view(-3.0)), reference(5, view(3.0))
    found = interpolate_by_tracks(around, 1, (points[0], points[1], points[2]))
    for plane in (found.luma, *found.compensated, *found.hypotheses):
        assert plane.shape == (HEIGHT, WIDTH)
        assert (plane >= -1e-6).all()
        assert (plane <= 255.0 + 1e-6).all()
    assert np.isfinite(found.expected_error).all()
    assert (found.expected_error > 0.0).all()
    np.testing.assert_allclose(found.weights[0] + found.weights[1], 1.0)


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
    reference, _, points = scene()
    warp = warp_by_tracks(reference, points, points + np.array([10.0, 0.0]))
    np.testing.assert_array_equal(warp.coverage[:, -10:], 0.0)
    np.testing.assert_allclose(warp.coverage[:, :-10], 1.0, atol=1e-6)
    np.testing.assert_allclose(warp.displacement_px, 10.0, atol=1e-6)
    assert warp.expected_error[:, -10:].mean() > 1.5 * warp.expected_error[:, :-10].mean()


@pytest.mark.parametrize("axis", ["motion", "detail"])
def test_errors_grow_with_motion_and_detail(axis: str) -> None:
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
    reference, _, points = scene()
    matches = points + np.array([3.0, 1.0])
    matches[known:] = np.nan
    warp = warp_by_tracks(reference, points, matches)
    expected = [0.0, 0.0] if known == 0 else [3.0, 1.0]
    np.testing.assert_allclose(warp.positions - grid(), np.broadcast_to(expected, (*SHAPE, 2)), atol=1e-6)
