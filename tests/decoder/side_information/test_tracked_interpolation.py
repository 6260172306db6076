"""Frames between two references that tracks alone bring into place."""

import numpy as np
import pytest
from numpy.typing import NDArray

from decoder.side_information.block_motion.alignment import AlignedBlockMotion
from decoder.side_information.protocol import Interpolation, ReferenceFrame
from decoder.side_information.tracked_interpolation import interpolate_by_tracks
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
    old = AlignedBlockMotion().predict(around, 6, points)
    return interpolate_by_tracks(around, 6, points), to_uint8(old.luma)


def test_what_one_reference_does_not_cover_is_taken_from_the_other() -> None:
    """Under a fast pan the sides of the frame are in one reference each; aligned block motion blurs both."""
    shifts = -24.0, 24.0
    found, old = predicted(view(shifts[0]), view(shifts[1]), shifts)
    wanted = view(0.0)
    assert psnr_db(to_uint8(found.luma), wanted) > psnr_db(old, wanted) + 6.0
    for side in (np.s_[:, :20], np.s_[:, -20:]):
        assert np.abs(found.luma - wanted)[side].mean() < 2.0


def test_a_reference_where_the_camera_paused_is_the_frame() -> None:
    """The view of no motion decides, however bad the other one is."""
    wrong = np.random.default_rng(7).integers(0, 255, (HEIGHT, WIDTH)).astype(np.uint8)
    found, old = predicted(view(0.0), wrong, (0.0, 16.0))
    assert psnr_db(to_uint8(found.luma), view(0.0)) > 34.0
    assert psnr_db(old, view(0.0)) < 25.0


def test_references_of_one_quality_are_averaged() -> None:
    """Where both agree but for noise, and neither is nearer, each has half a say, and the noise falls."""
    found, _ = predicted(view(-4.0, noise=4.0), view(4.0, noise=4.0), (-4.0, 4.0))
    inside = np.s_[:, 8:-8]
    np.testing.assert_allclose(found.weights[0][inside], 0.5, atol=0.02)
    each = [np.abs(plane - view(0.0))[inside].mean() for plane in found.compensated]
    assert np.abs(found.luma - view(0.0))[inside].mean() < 0.85 * min(each)


def test_the_expected_error_is_larger_where_references_disagree() -> None:
    """A patch that is in one reference alone is expected to be wrong, and nothing else is."""
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
    """Whatever was received, luma, errors and weights are finite and in range."""
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
