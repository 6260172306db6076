"""Robust weak calibration and classes of motion: accuracy, outliers, failure as a value."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sfm.estimation.epipolar import symmetric_distances
from sfm.estimation.weak_calibration import MotionClass, classify_motion, gric, spread, weak_calibration
from sfm.scene_model import Correspondences
from tests.sfm.two_views import odd_correspondences, two_views


@pytest.mark.parametrize("kind", ["general", "planar"])
@pytest.mark.parametrize("outlier_share", [0.0, 0.2, 0.5])
@pytest.mark.parametrize("seed", [0, 1])
def test_accuracy_among_outliers(kind: str, outlier_share: float, seed: int) -> None:
    """True matches are within a tenth of a pixel of the lines of a matrix found in noise and outliers."""
    scene = two_views(500, kind, noise_px=0.1, outlier_share=outlier_share, seed=seed)  # type: ignore[arg-type]
    found = weak_calibration(scene.measured, np.random.default_rng(seed))
    assert not found.reason
    distances = symmetric_distances(found.fundamental, scene.exact.first, scene.exact.second)
    assert np.median(distances) <= 0.05
    assert np.quantile(distances, 0.95) <= 0.2
    assert found.inliers[~scene.outliers].mean() > 0.98
    if outlier_share:
        assert found.inliers[scene.outliers].mean() < 0.12
    assert 0.08 < found.noise_px < 0.13


def test_exact_matches_give_the_exact_matrix() -> None:
    scene = two_views(100)
    found = weak_calibration(scene.exact, np.random.default_rng(0))
    truth = scene.fundamental
    assert min(np.abs(found.fundamental - truth).max(), np.abs(found.fundamental + truth).max()) < 1e-9
    assert np.linalg.norm(found.fundamental) == pytest.approx(1.0)
    assert np.linalg.svd(found.fundamental)[1][2] < 1e-15
    assert found.inliers.all()
    first = scene.exact.first.copy()
    first[::5, 0] = np.nan
    found = weak_calibration(replace(scene.exact, first=first), np.random.default_rng(0))
    assert not found.reason
    assert (found.inliers == (np.arange(100) % 5 > 0)).all()
    assert np.isinf(found.residuals_px[::5]).all()


@pytest.mark.parametrize(("name", "pairs"), odd_correspondences().items())
def test_odd_inputs_are_values(name: str, pairs: Correspondences) -> None:
    found = weak_calibration(pairs, np.random.default_rng(0))
    assert np.isfinite(found.fundamental).all()
    assert found.inliers.shape == found.residuals_px.shape == (len(pairs),)
    assert not np.isnan(found.residuals_px).any()
    if name.endswith("points") or name in {"random", "nan", "huge"}:
        assert found.reason
    assert motion_of(pairs).kind in {"none"} if name == "no motion" else {"none", "unknown", "rotation"}


def motion_of(pairs: Correspondences, seed: int = 0) -> MotionClass:
    rng = np.random.default_rng(seed)
    return classify_motion(pairs, weak_calibration(pairs, rng), rng)


@pytest.mark.parametrize(("noise_px", "seed"), [(0.0, 0), (0.1, 1), (0.3, 2)])
@pytest.mark.parametrize(
    ("kind", "expected"), [("general", "general"), ("planar", "rotation"), ("rotation", "rotation")]
)
def test_kinds_of_motion(kind: str, expected: str, noise_px: float, seed: int) -> None:
    """Parallax is seen in noise and outliers; a plane or a pure rotation is never taken for it."""
    scene = two_views(300, kind, noise_px=noise_px, outlier_share=0.1, seed=seed)  # type: ignore[arg-type]
    found = motion_of(scene.measured, seed)
    assert found.kind == expected
    assert found.reason
    assert "\n" not in found.reason


@pytest.mark.parametrize("noise_px", [0.0, 0.1])
def test_a_camera_that_stands_still(noise_px: float) -> None:
    scene = two_views(200, motion=0.0, noise_px=noise_px)
    assert motion_of(scene.measured).kind == "none"
    # A step so small that parallax drowns in the noise gives no depth.
    scene = two_views(300, motion=0.04, noise_px=0.4)
    assert motion_of(scene.measured).kind == "rotation"


@pytest.mark.parametrize("seed", range(3))
def test_a_plane_that_hides_most_of_the_scene(seed: int) -> None:
    """Where two points in three lie on a plane, the rest still shows parallax, in strong noise too."""
    plane = two_views(200, "planar", noise_px=0.3, seed=seed).measured
    rest = two_views(100, "general", noise_px=0.3, seed=seed + 9).measured
    assert motion_of(Correspondences.concatenate([plane, rest])).kind == "general"


def test_spread_is_across_the_longest_direction() -> None:
    """Of a band of points anywhere: half its width, whichever way it runs; none of a line."""
    x, y = np.meshgrid(np.arange(300.0), [-3.0, 3.0])
    band = np.stack([x.ravel(), y.ravel()], axis=1)
    turned = band @ np.array([[0.8, 0.6], [-0.6, 0.8]]) + [500.0, -200.0]
    assert spread(turned) == pytest.approx(3.0)
    assert spread(turned[:300]) == pytest.approx(0.0, abs=1e-6)


def test_gric_counts_parameters_and_truncates() -> None:
    """Perfect fits differ by dimensions and parameters; one outlier costs no more than its bound."""
    perfect = np.zeros(100)
    plane, depth = gric(perfect, 1.0, 2, 8), gric(perfect, 1.0, 3, 7)
    assert depth - plane == pytest.approx(np.log(4.0) * 100 - np.log(400.0))
    perfect[0] = 1e9
    assert gric(perfect, 1.0, 2, 8) - plane == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("clip", "start", "expected"),
    [("river", 0, "rotation"), ("river", 50, "rotation"), ("box", 0, "general"), ("tree", 0, "general")],
)
def test_real_clips(shared_sequences: Path, clip: str, start: int, expected: str) -> None:
    import cv2

    from dvc.video.readers import open_video

    frames: list[Any] = []
    with open_video(shared_sequences / f"{clip}.mkv") as video:
        for index, frame in enumerate(video):
            if index in {start, start + 10}:
                frames.append(frame.luma)
            if index == start + 10:
                break
    corners = cv2.goodFeaturesToTrack(frames[0], 600, 0.01, 6)
    there, ok, _ = cv2.calcOpticalFlowPyrLK(frames[0], frames[1], corners, None, maxLevel=4)  # type: ignore[call-overload]
    back, _, _ = cv2.calcOpticalFlowPyrLK(frames[1], frames[0], there, None, maxLevel=4)  # type: ignore[call-overload]
    good = (ok[:, 0] > 0) & (np.linalg.norm((back - corners)[:, 0], axis=1) < 0.3)
    pairs = Correspondences(
        corners[good, 0].astype(float), there[good, 0].astype(float), np.zeros(np.count_nonzero(good))
    )
    assert motion_of(pairs).kind == expected
