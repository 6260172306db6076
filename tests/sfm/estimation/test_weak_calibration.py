"""Robust weak calibration: accuracy, outliers, failure as a value."""

import numpy as np
import pytest

from sfm.estimation.epipolar import symmetric_distances
from sfm.estimation.weak_calibration import weak_calibration
from sfm.scene_model import Correspondences
from tests.sfm.two_views import odd_correspondences, two_views


@pytest.mark.parametrize("kind", ["general", "planar"])
@pytest.mark.parametrize("outlier_share", [0.0, 0.2, 0.5])
@pytest.mark.parametrize("seed", [0, 1])
def test_accuracy_among_outliers(kind: str, outlier_share: float, seed: int) -> None:
    """True matches are within a tenth of a pixel of the lines of a matrix found in noise and outliers."""
    scene = two_views(500, kind, noise_px=0.1, outlier_share=outlier_share, seed=seed)  # type: ignore[arg-type]
    found = weak_calibration(scene.measured, np.random.default_rng(seed))
    assert found.success
    distances = symmetric_distances(found.fundamental, scene.exact.first, scene.exact.second)
    assert np.median(distances) <= 0.05
    assert np.quantile(distances, 0.95) <= 0.2
    assert found.inliers[~scene.outliers].mean() > 0.98
    if outlier_share:
        assert found.inliers[scene.outliers].mean() < 0.12
    assert 0.08 < found.noise_px < 0.13


def test_exact_matches_give_the_exact_matrix() -> None:
    """Without noise the matrix is the true one, of rank 2 and unit norm."""
    scene = two_views(100)
    found = weak_calibration(scene.exact, np.random.default_rng(0))
    truth = scene.fundamental
    assert min(np.abs(found.fundamental - truth).max(), np.abs(found.fundamental + truth).max()) < 1e-9
    assert np.linalg.norm(found.fundamental) == pytest.approx(1.0)
    assert np.linalg.svd(found.fundamental)[1][2] < 1e-15
    assert found.inliers.all()


def test_the_same_generator_gives_the_same_matrix() -> None:
    """The result depends on data and generator alone."""
    scene = two_views(100, noise_px=0.2, outlier_share=0.3)
    runs = [weak_calibration(scene.measured, np.random.default_rng(4)) for _ in range(2)]
    np.testing.assert_array_equal(runs[0].fundamental, runs[1].fundamental)


@pytest.mark.parametrize(("name", "pairs"), odd_correspondences().items())
def test_odd_inputs_are_values(name: str, pairs: Correspondences) -> None:
    """No input raises or warns; whatever comes is finite, and a failure says why."""
    found = weak_calibration(pairs, np.random.default_rng(0))
    assert np.isfinite(found.fundamental).all()
    assert found.inliers.shape == found.residuals_px.shape == (len(pairs),)
    assert not np.isnan(found.residuals_px).any()
    assert found.success == (not found.reason)
    if name.endswith("points") or name in {"random", "nan", "huge"}:
        assert not found.success


def test_points_that_are_not_finite_are_outliers() -> None:
    """Good points among infinite ones are used, the others are marked."""
    scene = two_views(100, noise_px=0.1)
    first = scene.measured.first.copy()
    first[::5, 0] = np.nan
    found = weak_calibration(
        Correspondences(first, scene.measured.second, np.zeros(100)), np.random.default_rng(0)
    )
    assert found.success
    assert not found.inliers[::5].any()
    assert np.isinf(found.residuals_px[::5]).all()
