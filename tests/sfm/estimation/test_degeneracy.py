"""What the camera did, told from points with noise."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sfm.estimation import degeneracy
from sfm.estimation.degeneracy import MotionClass, classify_motion, gric
from sfm.estimation.two_view_estimators import HomographyEstimator
from sfm.estimation.weak_calibration import weak_calibration
from sfm.scene_model import Correspondences
from tests.sfm.two_views import odd_correspondences, two_views


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
    """Noise alone is no motion."""
    scene = two_views(200, motion=0.0, noise_px=noise_px)
    assert motion_of(scene.measured).kind == "none"


def test_parallax_within_the_noise_is_none() -> None:
    """A step so small that parallax drowns in the noise gives no depth."""
    scene = two_views(300, motion=0.04, noise_px=0.4)
    assert motion_of(scene.measured).kind == "rotation"


@pytest.mark.parametrize("seed", range(3))
def test_a_plane_that_hides_most_of_the_scene(seed: int) -> None:
    """Where two points in three lie on a plane, the rest still shows parallax, in strong noise too."""
    plane = two_views(200, "planar", noise_px=0.3, seed=seed).measured
    rest = two_views(100, "general", noise_px=0.3, seed=seed + 9).measured
    assert motion_of(Correspondences.concatenate([plane, rest])).kind == "general"


@pytest.mark.parametrize(("name", "pairs"), odd_correspondences().items())
def test_odd_inputs_have_a_kind(name: str, pairs: Correspondences) -> None:
    """No input raises or warns, and none passes for a scene with depth."""
    found = motion_of(pairs)
    assert found.kind in {"none", "unknown", "rotation"}
    assert found.kind == "none" or name != "no motion"


def test_homographies_are_exact_on_exact_matches() -> None:
    """Four points of a plane give the homography of all of them."""
    scene = two_views(50, "planar")
    estimator = HomographyEstimator(scene.exact.first, scene.exact.second)
    models = estimator.estimate(np.array([[0, 1, 2, 3], [10, 20, 30, 40]]))
    assert estimator.residuals(models).max() < 1e-7
    refined = estimator.refine(models[0], np.ones(50, dtype=bool))
    assert estimator.residuals(refined[None]).max() < 1e-7
    assert estimator.estimate(np.empty((0, 4), dtype=np.int64)).shape == (0, 3, 3)


def test_sampson_distance_of_a_translation() -> None:
    """Under a pure translation an offset splits evenly between both points."""
    first = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]])
    estimator = HomographyEstimator(first, first + np.array([6.0, 8.0]))
    identity = estimator.scale.matrices()
    model = identity[1] @ np.linalg.inv(identity[0])
    np.testing.assert_allclose(estimator.residuals(model[None]), np.sqrt(0.5) * 10.0)


def test_spread_is_across_the_longest_direction() -> None:
    """Of a band of points anywhere: half its width, whichever way it runs; none of a line."""
    x, y = np.meshgrid(np.arange(300.0), [-3.0, 3.0])
    band = np.stack([x.ravel(), y.ravel()], axis=1)
    turned = band @ np.array([[0.8, 0.6], [-0.6, 0.8]]) + [500.0, -200.0]
    assert degeneracy._spread(turned) == pytest.approx(3.0)
    assert degeneracy._spread(turned[:300]) == pytest.approx(0.0, abs=1e-6)


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
    """A pan over a river has no parallax; walks around a box and a tree have."""
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
