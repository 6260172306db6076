"""From two key frames to a model of the scene: the boxes of figure 5.2 [Maitre2008, Sec. 5.2], in order."""

import numpy as np

from dvc.arrays import Bytes, Floats
from dvc.config import SFM_BACKENDS
from dvc.geometry.cameras import PixelFrame
from dvc.geometry.triangulation import triangulate_depth
from sfm import colmap_estimators
from sfm.cameras.camera_pair import SelfCalibrationSettings, bundle_adjustment, self_calibration
from sfm.correspondences import outliers
from sfm.correspondences.epipolar_search import EpipolarSearch
from sfm.correspondences.point_matching import densify, detect_corners, match_corners, propagate
from sfm.estimation.weak_calibration import classify_motion, weak_calibration
from sfm.scene_model import CameraPair, Correspondences, Model, Reconstruction

COVERAGE_CELLS = 8
NUM_ADJUSTMENTS = 3
"""Number of bundle adjustments, with outliers removed in between."""
ALTERNATIONS = 100
"""Number of alternations without joint steps; the thesis does not specify it."""
AS_WRITTEN = SelfCalibrationSettings(
    first_depth_ratio=None, dropped_share=0.0, max_dropped_share=0.0, free_unit=False
)
"""The linear program exactly as in section 5.2 of the thesis."""
MIN_NUM_POINTS = 100
"""Number of correspondences of a trusted model from CIF size on; smaller pictures need down to half of it. On
the clip "stone" (QP 32, 17 frames) 50 and 200 took 5 % more Wyner-Ziv bits than 100."""
MIN_COVERAGE = 0.25
"""Least share of the cells of an 8x8 grid that hold a correspondence of a trusted model."""
MIN_INLIER_SHARE = 0.4
"""Least share of the matched corners that agree with the epipolar geometry of a trusted model."""


def reconstruct(
    first: Bytes,
    second: Bytes,
    *,
    backend: str = "native",
    seed: int = 0,
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
    rng, stages = np.random.default_rng(seed), dict[str, Correspondences]()
    frame = PixelFrame(first.shape[1], first.shape[0])
    corners = detect_corners(first), detect_corners(second)
    matches = match_corners(first, second, *corners)  # tests of MSE and unicity
    matches = Correspondences.concatenate([tracked or Correspondences.empty(), matches])
    stages["matching"] = matches

    if backend == "colmap":
        calibration = colmap_estimators.weak_calibration(matches, int(rng.integers(2**31 - 1)))
    else:
        calibration = weak_calibration(matches, rng)
    motion = classify_motion(matches, calibration, rng)
    if motion.kind != "general":
        return Reconstruction(None, motion.reason, motion.kind, stages)
    matches = matches[calibration.inliers]  # the epipolar test
    matches = matches[outliers.motion(matches)]
    stages["weak calibration"] = matches

    if backend == "colmap":
        pair = colmap_estimators.camera_pair(matches, frame, int(rng.integers(2**31 - 1)))
    else:
        pair = _camera_pair(matches, calibration.fundamental, frame, rng, as_written=backend == "thesis")
    if pair.reason:
        return Reconstruction(None, pair.reason, motion.kind, stages)
    matches = _well_triangulated(matches[pair.inliers], pair, frame)
    stages["bundle adjustment"] = matches

    search = EpipolarSearch(first, second, pair.fundamental)
    matches = densify(search, *corners, search.settle_on_surfaces(matches))
    matches = matches[outliers.motion(matches)]
    matches = propagate(search, matches)
    matches = _well_triangulated(matches, pair, frame)
    stages["propagation"] = matches

    depths, _ = _triangulated(matches, pair.camera, frame)
    model = Model(frame, pair.fundamental, pair.camera, matches, depths)
    reason, needed, covered = "", points_needed(frame), coverage(matches.first, frame)
    share = float(calibration.inliers.mean())
    if len(matches) < needed:
        reason = f"only {len(matches)} correspondences, {needed} are needed"
    elif covered < MIN_COVERAGE:
        reason = f"correspondences cover only {100 * covered:.0f} % of the frame"
    elif share < MIN_INLIER_SHARE:
        reason = f"only {100 * share:.0f} % of the matched corners agree with one rigid motion"
    return Reconstruction(model, reason, motion.kind, stages)


def _camera_pair(
    matches: Correspondences, matrix: Floats, frame: PixelFrame, rng: np.random.Generator, as_written: bool
) -> CameraPair:
    """Self-calibrate, adjust, remove outliers by reprojection, and adjust again."""
    num, limits = len(matches), (ALTERNATIONS, 0) if as_written else ()
    start = self_calibration(matrix, matches, frame, AS_WRITTEN if as_written else None)
    if start.reason:
        return CameraPair.missing(num, f"self-calibration: {start.reason}")
    camera, depths, inliers, fundamental = start.camera, start.depths, start.inliers, matrix
    for _ in range(NUM_ADJUSTMENTS):
        chosen = np.flatnonzero(inliers)
        points = matches[chosen]
        adjusted = bundle_adjustment(points, camera, depths[chosen], frame, rng, *limits)
        if adjusted.reason:
            return CameraPair.missing(num, f"bundle adjustment: {adjusted.reason}")
        camera, fundamental, depths[chosen] = adjusted.camera, adjusted.fundamental, adjusted.depths
        good = outliers.reprojection(points.second, adjusted.second) & adjusted.in_front
        inliers[chosen[~good]] = False
        if good.all() or np.count_nonzero(inliers) < points_needed(frame):
            break
    return CameraPair(camera, fundamental, inliers)


def _triangulated(matches: Correspondences, camera: Floats, frame: PixelFrame) -> tuple[Floats, Floats]:
    first, second = frame.to_normalized(matches.first), frame.to_normalized(matches.second)
    return triangulate_depth(first, camera, second)


def _well_triangulated(matches: Correspondences, pair: CameraPair, frame: PixelFrame) -> Correspondences:
    """Apply the tests of chirality, epipole and depth."""
    depth_first, depth_second = _triangulated(matches, pair.camera, frame)
    keep = outliers.chirality(depth_first, depth_second) & (np.nan_to_num(depth_first) > 0)
    keep &= outliers.epipole(matches, pair.fundamental)
    matches, depths = matches[keep], depth_first[keep]
    return matches[outliers.depth(matches.first, depths)]


def points_needed(frame: PixelFrame) -> int:
    """Return the number of correspondences that a trusted model of a frame needs."""
    share = frame.width_px * frame.height_px / (352 * 288)
    return round(MIN_NUM_POINTS * min(max(share, 0.5), 1.0))


def coverage(points: Floats, frame: PixelFrame) -> float:
    """Return the share of a frame's cells that hold a point."""
    size = np.array([frame.width_px, frame.height_px])
    cells = np.clip((points + 0.5) * COVERAGE_CELLS // size, 0, COVERAGE_CELLS - 1).astype(np.int64)
    return len(np.unique(cells[:, 0] * COVERAGE_CELLS + cells[:, 1])) / COVERAGE_CELLS**2
