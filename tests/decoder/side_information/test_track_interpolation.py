"""Frames between two references that tracks alone align; residuals of tracks as local corrections."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.protocol import Interpolation, ReferenceFrame
from decoder.side_information.track_interpolation import (
    NEAR,
    PRIOR,
    add_correction,
    aligned_block_motion,
    corrected,
    correction_field,
    homography_positions,
    interpolate_by_tracks,
    track_residuals,
    warp_by_tracks,
    warp_frame,
    whole_frame_motion,
)
from dvc._jit import python_twin
from dvc.geometry.warping import sample
from dvc.metrics import psnr_db
from dvc.video import Frame
from dvc.wynerziv.transform import to_uint8
from tests.clips import moving_texture
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


def test_errors_grow_with_motion_and_detail() -> None:
    reference, _, points = scene()
    flat = np.full(SHAPE, 90, np.uint8)
    for (less, less_px), (more, more_px) in (
        ((reference, 0.0), (reference, 8.0)),
        ((flat, 4.0), (reference, 4.0)),
    ):
        low, high = (
            warp_by_tracks(plane, points, points + np.array([shift, 0.0])).expected_error[:, :-12]
            for plane, shift in ((less, less_px), (more, more_px))
        )
        assert (high >= low).all()
        assert high.mean() > 1.2 * low.mean()


TILT = np.array([[1.02, 0.03, -4.0], [-0.02, 0.99, 3.0], [1e-4, -5e-5, 1.0]])


def mapped(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    image = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return image[:, :2] / image[:, 2:]


def points(number: int, seed: int = 0) -> np.ndarray:
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


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (np.full((60, 2), 40.0), points(60, seed=2)),
        (points(60) * [1.0, 0.0] + [0.0, 30.0], points(60, seed=2)),
        (points(60), points(60, seed=2)),
        (points(60), points(60) * [-1.0, 1.0] + [175.0, 0.0]),
        (points(60), np.full((60, 2), 20.0)),
    ],
    ids=["one place", "line", "noise", "turned over", "all to one place"],
)
def test_hostile_points_give_a_sane_map(first: Floats, second: Floats) -> None:
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


SMALL = (40, 56)
FIELD = NEAR[0]


def points_and_residuals(seed: int, number: int) -> tuple[Floats, Floats]:
    """Return scattered points whose residuals agree but for some noise."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0.0, 39.0, (number, 2))
    return points, np.array([2.0, -1.0]) + rng.normal(0.0, 0.3, (number, 2))


def plain_field(points: Floats, residuals: Floats, reach: float) -> Floats:
    field = np.zeros((*SMALL, 2))
    for y, x in np.ndindex(*SMALL):
        squared = ((points - np.array([x, y])) ** 2).sum(axis=1)
        weights = np.maximum(1.0 - squared / reach**2, 0.0) ** 3
        if weights.sum() == 0.0:
            continue
        mean = np.average(residuals, axis=0, weights=weights)
        spread = float(np.average(((residuals - mean) ** 2).sum(axis=1), weights=weights))
        chance = (spread + FIELD.noise_px2) * (weights**2).sum() / weights.sum() ** 2
        share = max(0.0, 1.0 - chance / float(mean @ mean))
        field[y, x] = mean * share * weights.sum() / (weights.sum() + PRIOR)
    return field


@pytest.mark.nojit
@pytest.mark.parametrize("reach", [15.0, FIELD.reach_px])
@pytest.mark.parametrize("compiled", [True, False])
def test_the_kernel_is_its_twin(compiled: bool, reach: float) -> None:
    points, residuals = points_and_residuals(1, 12)
    field = np.empty((*SMALL, 2))
    run = correction_field if compiled else python_twin(correction_field)
    run(points, residuals, reach, PRIOR, FIELD.noise_px2, field)
    np.testing.assert_allclose(field, plain_field(points, residuals, reach), atol=1e-9)
    assert (field[:, -1] == 0.0).any() == (reach == 15.0)


def test_what_neighbours_agree_on_is_corrected() -> None:
    points, residuals = points_and_residuals(2, 40)
    nowhere = np.zeros((*SMALL, 2))
    agreed = add_correction(nowhere, points, residuals, FIELD)[20, 20]
    np.testing.assert_allclose(agreed, [2.0, -1.0], atol=0.3)
    signs = np.where(np.arange(40) % 2, 1.0, -1.0)[:, None]
    assert np.abs(add_correction(nowhere, points, residuals * signs, FIELD)).max() < 0.5
    for few in (0, 2):
        assert not add_correction(nowhere, points[:few], residuals[:few], FIELD).any()


def test_a_correction_is_bilinear_between_nodes() -> None:
    points, residuals = points_and_residuals(4, 12)
    start = np.random.default_rng(4).normal(size=(*SMALL, 2))
    field = add_correction(start, points, residuals, FIELD) - start
    at = np.mgrid[:37, :53] / 4
    bilinear = [map_coordinates(field[::4, ::4, axis], at, order=1) for axis in (0, 1)]
    np.testing.assert_allclose(field[:37, :53], np.stack(bilinear, axis=-1), atol=1e-12)
    assert np.abs(field).max() > 0.5


def test_only_points_that_tell_something_count() -> None:
    rows, columns = np.indices(SMALL).astype(np.float64)
    positions = np.stack([columns + 1.0, rows], axis=-1)
    wanted = np.array([[10.5, 7.25], [np.nan, 3.0], [-0.1, 3.0], [55.5, 3.0], [20.0, 20.0], [5.0, 5.0]])
    reference = wanted + np.array([1.5, 0.5])
    reference[4] += 10.0
    reference[5] = np.nan
    points, residuals = track_residuals(wanted, reference, positions, FIELD.max_residual_px)
    np.testing.assert_array_equal(points, [[10.5, 7.25]])
    np.testing.assert_allclose(residuals, [[0.5, 0.5]])


def test_a_camera_that_is_off_is_made_up_for() -> None:
    keys = moving_texture(1, *SMALL)[0].luma, moving_texture(1, *SMALL)[0].luma
    rows, columns = np.indices(SMALL).astype(np.float64)
    true = np.stack([columns, rows], axis=-1)
    off = true + np.array([2.0, -1.0])
    half = np.full(SMALL, 0.5)
    wrong = sample(keys[0], off)
    rendered = Interpolation(wrong, (wrong, wrong), (half, half), (off, off), half)
    points = np.random.default_rng(3).uniform(0.0, 39.0, (60, 2))
    found = corrected(rendered, keys, (points, points, points))
    errors = [np.abs(luma - keys[0])[4:-4, 4:-20].mean() for luma in (wrong, found.luma)]
    assert errors[1] < 0.2 * errors[0]
    np.testing.assert_allclose(found.compensated[0], found.luma)
    nothing = corrected(rendered, keys, (points[:0],) * 3)
    np.testing.assert_array_equal(nothing.luma, wrong)
