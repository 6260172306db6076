"""From two key frames to a model of the scene: the boxes of figure 5.2, in order.

References
----------
[Maitre2008] Sec. 5.2.
"""

import numpy as np
from numpy.typing import NDArray

from dvc.multiview.cameras import PixelFrame
from dvc.multiview.triangulation import triangulate_depth
from sfm.backends import BACKENDS, CameraPair
from sfm.correspondences import outliers
from sfm.correspondences.densification import densify
from sfm.correspondences.features import detect_corners
from sfm.correspondences.matching import match_corners
from sfm.correspondences.propagation import propagate, settle_on_surfaces
from sfm.estimation.degeneracy import classify_motion
from sfm.estimation.weak_calibration import WeakCalibration
from sfm.model import Correspondences, Model, Reconstruction
from sfm.settings import SfmSettings

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
) -> Reconstruction:
    """Reconstruct a static scene from two key frames.

    Parameters
    ----------
    first, second : ndarray of shape (H, W), uint8
        Luma of the key frames.
    backend : str
        Whose estimators find the cameras: ``native`` or ``colmap``.
    seed : int
        Of everything random.
    settings : SfmSettings, optional
        Parameters; the defaults if None.

    Returns
    -------
    Reconstruction
        The model, or why there is none that can be trusted; never an exception for what the frames show.

    Raises
    ------
    ValueError
        If the frames differ in size, or there is no such backend.
    """
    if first.shape != second.shape or first.ndim != 2:
        raise ValueError(
            f"`first` and `second` must be planes of one size, got {first.shape}, {second.shape}"
        )
    if backend not in BACKENDS:
        raise ValueError(f"`backend` must be one of {', '.join(BACKENDS)}, got {backend!r}")
    settings = settings or SfmSettings()
    rng = np.random.default_rng(seed)
    estimators, frame = BACKENDS[backend], PixelFrame(first.shape[1], first.shape[0])
    stages: dict[str, Correspondences] = {}

    corners = detect_corners(first, settings.features), detect_corners(second, settings.features)
    matches = match_corners(first, second, corners[0], corners[1], settings.matching)
    stages["matching"] = matches
    calibration = estimators.calibrate(matches, settings, rng)
    motion = classify_motion(matches, calibration, rng, settings.degeneracy)
    if motion.kind != "general":
        return Reconstruction(None, motion.reason, motion.kind, stages)
    matches = matches[calibration.inliers]
    matches = matches[outliers.motion(matches, settings.motion_limit_px, settings.motion_spreads)]
    stages["weak calibration"] = matches
    pair = estimators.cameras(matches, calibration, frame, settings, rng)
    if pair.reason:
        return Reconstruction(None, pair.reason, motion.kind, stages)
    matches = _tested(matches[pair.kept], pair, frame, settings)
    stages["bundle adjustment"] = matches
    matches = _propagated((first, second), corners, pair.fundamental, matches, settings)
    model = _model(matches, pair, frame, settings)
    stages["propagation"] = model.correspondences
    return Reconstruction(model, _doubt(model, calibration, settings), motion.kind, stages)


def _propagated(
    frames: tuple[Image, Image],
    corners: tuple[Floats, Floats],
    fundamental: Floats,
    matches: Correspondences,
    settings: SfmSettings,
) -> Correspondences:
    """Densify over the corners that are left, then along edges."""
    matches = settle_on_surfaces(*frames, fundamental, matches, settings.propagation)
    matches = densify(*frames, *corners, fundamental, matches, settings.densification)
    matches = matches[outliers.motion(matches, settings.motion_limit_px, settings.motion_spreads)]
    return propagate(*frames, fundamental, matches, settings.propagation)


def _model(matches: Correspondences, pair: CameraPair, frame: PixelFrame, settings: SfmSettings) -> Model:
    """Triangulate the correspondences that pass the tests that need depths."""
    usual = _tested(matches, pair, frame, settings)
    first, second = frame.to_normalized(usual.first), frame.to_normalized(usual.second)
    depths, _ = triangulate_depth(first, pair.camera, second)
    return Model(frame, pair.fundamental, pair.camera, usual, depths)


def _tested(
    matches: Correspondences, pair: CameraPair, frame: PixelFrame, settings: SfmSettings
) -> Correspondences:
    """Apply the tests of chirality, epipole and depth."""
    first, second = frame.to_normalized(matches.first), frame.to_normalized(matches.second)
    depth_first, depth_second = triangulate_depth(first, pair.camera, second)
    keep = outliers.chirality(depth_first, depth_second) & (np.nan_to_num(depth_first) > 0)
    keep &= outliers.epipole(matches, pair.fundamental, settings.epipole_distance_px)
    chosen = np.flatnonzero(keep)
    usual = outliers.depth(
        matches.first[chosen], depth_first[chosen], settings.depth_share, settings.depth_spreads
    )
    return matches[chosen[usual]]


def _doubt(model: Model, calibration: WeakCalibration, settings: SfmSettings) -> str:
    """Say why a model cannot be trusted; nothing if it can."""
    count = len(model.correspondences)
    if count < settings.min_num_points:
        return f"only {count} correspondences, {settings.min_num_points} are needed"
    covered = coverage(model.correspondences.first, model.pixel_frame)
    if covered < settings.min_coverage:
        return f"correspondences cover only {100 * covered:.0f} % of the frame"
    share = float(calibration.inliers.mean())
    if share < settings.min_inlier_share:
        return f"only {100 * share:.0f} % of the matched corners agree with one rigid motion"
    return ""


def coverage(points: Floats, frame: PixelFrame) -> float:
    """Measure how much of a frame points cover.

    Parameters
    ----------
    points : ndarray of shape (N, 2), float64
        Image points (x, y) in pixels.
    frame : PixelFrame
        Size of the image.

    Returns
    -------
    float
        Share of the cells of an 8x8 grid that hold a point.
    """
    size = np.array([frame.width_px, frame.height_px])
    cells = np.clip((points + 0.5) * COVERAGE_CELLS // size, 0, COVERAGE_CELLS - 1).astype(np.int64)
    return len(np.unique(cells[:, 0] * COVERAGE_CELLS + cells[:, 1])) / COVERAGE_CELLS**2
