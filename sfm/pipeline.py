"""From two key frames to a model of the scene: the boxes of figure 5.2, in order.

References
----------
[Maitre2008] Sec. 5.2.
"""

import numpy as np
from numpy.typing import NDArray

from dvc.config import SFM_BACKENDS
from dvc.geometry.cameras import PixelFrame
from dvc.geometry.triangulation import triangulate_depth
from sfm import colmap_estimators
from sfm.cameras.bundle_adjustment import bundle_adjustment
from sfm.cameras.self_calibration import self_calibration
from sfm.correspondences import outliers
from sfm.correspondences.corner_matching import detect_corners, match_corners
from sfm.correspondences.densification import densify, propagate
from sfm.correspondences.epipolar_search import EpipolarSearch
from sfm.estimation.degeneracy import classify_motion
from sfm.estimation.sample_consensus import lo_ransac, mapsac
from sfm.estimation.two_view_estimators import FundamentalEstimator
from sfm.estimation.weak_calibration import WeakCalibration, least_sampson_distance
from sfm.reconstruction_settings import OutlierSettings, SfmSettings, TrustSettings
from sfm.scene_model import CameraPair, Correspondences, Model, Reconstruction

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

COVERAGE_CELLS = 8


def reconstruct(
    first: Image,
    second: Image,
    *,
    backend: str = "native",
    seed: int = 0,
    settings: SfmSettings | None = None,
    tracked: Correspondences | None = None,
) -> Reconstruction:
    """Reconstruct a static scene from two key frames.

    Parameters
    ----------
    first, second : ndarray of shape (H, W), uint8
        Luma of the key frames.
    backend : str
        Estimators of the cameras: ``native``, ``colmap`` or ``thesis``.
    seed : int
        Seed of the random samples.
    settings : SfmSettings, optional
        Parameters; the defaults if None.
    tracked : Correspondences, optional
        Points tracked from one frame to the other, in addition to matched corners.

    Returns
    -------
    Reconstruction
        The model, or the reason why none can be trusted; the content of the frames never raises.

    Raises
    ------
    ValueError
        If the frames differ in size, or the backend is unknown.
    """
    if first.shape != second.shape or first.ndim != 2:
        raise ValueError(
            f"`first` and `second` must be planes of one size, got {first.shape}, {second.shape}"
        )
    if backend not in SFM_BACKENDS:
        raise ValueError(f"`backend` must be one of {', '.join(SFM_BACKENDS)}, got {backend!r}")
    tracked = tracked or Correspondences.empty()
    settings = settings or SfmSettings()
    if backend == "thesis":
        settings = settings.as_written()
    return _reconstruct(first, second, tracked, backend, np.random.default_rng(seed), settings)


def _reconstruct(
    first: Image,
    second: Image,
    tracked: Correspondences,
    backend: str,
    rng: np.random.Generator,
    settings: SfmSettings,
) -> Reconstruction:
    """Take the steps of figure 5.2."""
    frame = PixelFrame(first.shape[1], first.shape[0])
    options, tests = settings.correspondences, settings.outliers
    stages: dict[str, Correspondences] = {}

    corners = detect_corners(first, options.features), detect_corners(second, options.features)
    matches = match_corners(first, second, *corners, options.matching)  # tests of MSE and unicity
    matches = Correspondences.concatenate([tracked, matches])
    stages["matching"] = matches

    if backend == "colmap":
        calibration = colmap_estimators.weak_calibration(matches, settings, _draw_seed(rng))
    else:
        calibration = weak_calibration(matches, rng, settings)
    motion = classify_motion(matches, calibration, rng, settings.degeneracy)
    if motion.kind != "general":
        return Reconstruction(None, motion.reason, motion.kind, stages)
    matches = matches[calibration.inliers]  # the epipolar test
    matches = _moving_alike(matches, tests)
    stages["weak calibration"] = matches

    if backend == "colmap":
        pair = colmap_estimators.camera_pair(matches, frame, settings, _draw_seed(rng))
    else:
        pair = _camera_pair(matches, calibration, frame, rng, settings)
    if pair.reason:
        return Reconstruction(None, pair.reason, motion.kind, stages)
    matches = _well_triangulated(matches[pair.inliers], pair, frame, tests)
    stages["bundle adjustment"] = matches

    search = EpipolarSearch(first, second, pair.fundamental, options.search)
    matches = densify(search, *corners, search.settle_on_surfaces(matches), options.densification)
    matches = _moving_alike(matches, tests)
    matches = propagate(search, matches, options.propagation)
    matches = _well_triangulated(matches, pair, frame, tests)
    stages["propagation"] = matches

    depths, _ = _triangulated(matches, pair.camera, frame)
    model = Model(frame, pair.fundamental, pair.camera, matches, depths)
    reason = _rejection_reason(model, calibration, settings.trust)
    return Reconstruction(model, reason, motion.kind, stages)


def weak_calibration(
    matches: Correspondences, rng: np.random.Generator, settings: SfmSettings
) -> WeakCalibration:
    """Estimate the fundamental matrix robustly."""
    options, finite = settings.weak_calibration, matches[matches.finite]
    estimator = FundamentalEstimator(finite.first, finite.second)
    result = mapsac(estimator, options.search, rng)
    result = lo_ransac(estimator, result, options.search, rng)
    return least_sampson_distance(matches, estimator, result, options)


def _camera_pair(
    matches: Correspondences,
    calibration: WeakCalibration,
    frame: PixelFrame,
    rng: np.random.Generator,
    settings: SfmSettings,
) -> CameraPair:
    """Self-calibrate, adjust, remove outliers by reprojection, and adjust again."""
    options, num = settings.cameras, len(matches)
    start = self_calibration(calibration.fundamental, matches, frame, options.self_calibration)
    if start.reason:
        return CameraPair.missing(num, f"self-calibration: {start.reason}")
    inliers, depths = start.kept.copy(), start.depths.copy()
    camera, fundamental = start.camera, calibration.fundamental
    for _ in range(options.num_adjustments):
        chosen = np.flatnonzero(inliers)
        points = matches[chosen]
        adjusted = bundle_adjustment(points, camera, depths[chosen], frame, rng, options.bundle_adjustment)
        if adjusted.reason:
            return CameraPair.missing(num, f"bundle adjustment: {adjusted.reason}")
        camera, fundamental, depths[chosen] = adjusted.camera, adjusted.fundamental, adjusted.depths
        near = outliers.reprojection(points.second, adjusted.second, settings.outliers.max_reprojection_px)
        good = near & adjusted.in_front
        inliers[chosen[~good]] = False
        if good.all() or np.count_nonzero(inliers) < settings.trust.num_points_needed(frame):
            break
    return CameraPair(camera, fundamental, inliers)


def _draw_seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**31 - 1))


def _moving_alike(matches: Correspondences, tests: OutlierSettings) -> Correspondences:
    """Apply the test of motion."""
    return matches[outliers.motion(matches, tests.motion_limit_px, tests.motion_spreads)]


def _triangulated(matches: Correspondences, camera: Floats, frame: PixelFrame) -> tuple[Floats, Floats]:
    first, second = frame.to_normalized(matches.first), frame.to_normalized(matches.second)
    return triangulate_depth(first, camera, second)


def _well_triangulated(
    matches: Correspondences, pair: CameraPair, frame: PixelFrame, tests: OutlierSettings
) -> Correspondences:
    """Apply the tests of chirality, epipole and depth."""
    depth_first, depth_second = _triangulated(matches, pair.camera, frame)
    keep = outliers.chirality(depth_first, depth_second) & (np.nan_to_num(depth_first) > 0)
    keep &= outliers.epipole(matches, pair.fundamental, tests.epipole_distance_px)
    matches, depths = matches[keep], depth_first[keep]
    return matches[outliers.depth(matches.first, depths, tests.depth_share, tests.depth_spreads)]


def _rejection_reason(model: Model, calibration: WeakCalibration, trust: TrustSettings) -> str:
    """Return the reason why a model cannot be trusted; empty if it can."""
    count, needed = len(model.correspondences), trust.num_points_needed(model.pixel_frame)
    if count < needed:
        return f"only {count} correspondences, {needed} are needed"
    covered = coverage(model.correspondences.first, model.pixel_frame)
    if covered < trust.min_coverage:
        return f"correspondences cover only {100 * covered:.0f} % of the frame"
    share = float(calibration.inliers.mean())
    if share < trust.min_inlier_share:
        return f"only {100 * share:.0f} % of the matched corners agree with one rigid motion"
    return ""


def coverage(points: Floats, frame: PixelFrame) -> float:
    """Return the share of a frame's cells that hold a point."""
    size = np.array([frame.width_px, frame.height_px])
    cells = np.clip((points + 0.5) * COVERAGE_CELLS // size, 0, COVERAGE_CELLS - 1).astype(np.int64)
    return len(np.unique(cells[:, 0] * COVERAGE_CELLS + cells[:, 1])) / COVERAGE_CELLS**2
