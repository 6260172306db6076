"""Whose estimators find the cameras: the project's own, as the thesis prescribes, or COLMAP's."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dvc.multiview.cameras import PixelFrame, homogeneous, project
from dvc.multiview.triangulation import triangulate_depth
from sfm import pycolmap_bridge
from sfm.cameras.bundle_adjustment import bundle_adjustment
from sfm.cameras.self_calibration import self_calibration
from sfm.correspondences import outliers
from sfm.estimation.epipolar import sampson_distances
from sfm.estimation.weak_calibration import WeakCalibration, weak_calibration
from sfm.model import Correspondences
from sfm.settings import SfmSettings

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class CameraPair:
    """The second camera, and the points that agree with it.

    Attributes
    ----------
    camera : ndarray of shape (3, 4), float64
        Second camera in normalised coordinates, Frobenius norm sqrt(3); the first is ``[I | 0]``.
    fundamental : ndarray of shape (3, 3), float64
        F in pixels, unit norm.
    kept : ndarray of shape (N,), bool
        Correspondences that passed all tests.
    reason : str
        Why there is no camera; empty if there is one.
    """

    camera: Floats
    fundamental: Floats
    kept: Mask
    reason: str = ""


class Backend(Protocol):
    """Finds epipolar geometry and cameras."""

    def calibrate(
        self, matches: Correspondences, settings: SfmSettings, rng: np.random.Generator
    ) -> WeakCalibration:
        """Find the fundamental matrix in spite of wrong correspondences."""

    def cameras(
        self,
        matches: Correspondences,
        calibration: WeakCalibration,
        frame: PixelFrame,
        settings: SfmSettings,
        rng: np.random.Generator,
    ) -> CameraPair:
        """Find the second camera from correspondences without outliers, or with few."""


class NativeBackend:
    """MAPSAC, LO-RANSAC, Sampson refinement; self-calibration by linear programming; bundle adjustment."""

    def calibrate(
        self, matches: Correspondences, settings: SfmSettings, rng: np.random.Generator
    ) -> WeakCalibration:
        """Find the fundamental matrix; see `sfm.estimation.weak_calibration`.

        Parameters
        ----------
        matches : Correspondences
            Outliers included.
        settings : SfmSettings
            Parameters.
        rng : Generator
            Source of randomness.

        Returns
        -------
        WeakCalibration
            The matrix, or the reason why there is none.
        """
        return weak_calibration(matches, rng, settings.weak_calibration)

    def cameras(
        self,
        matches: Correspondences,
        calibration: WeakCalibration,
        frame: PixelFrame,
        settings: SfmSettings,
        rng: np.random.Generator,
    ) -> CameraPair:
        """Self-calibrate, adjust, remove the outliers that this shows, and adjust again.

        Parameters
        ----------
        matches : Correspondences
            Reliable points, in pixels.
        calibration : WeakCalibration
            Their epipolar geometry.
        frame : PixelFrame
            Size of the images.
        settings : SfmSettings
            Parameters.
        rng : Generator
            Source of randomness.

        Returns
        -------
        CameraPair
            The camera, or the reason why there is none.
        """
        start = self_calibration(calibration.fundamental, matches, frame, settings.self_calibration)
        if start.reason:
            return _no_camera(matches, f"self-calibration: {start.reason}")
        kept = start.kept.copy()
        camera, depths, fundamental = start.camera, start.depths, calibration.fundamental
        for _ in range(settings.num_adjustments):
            chosen = np.flatnonzero(kept)
            points = matches[chosen]
            adjusted = bundle_adjustment(
                points, camera, depths[chosen], frame, rng, settings.bundle_adjustment
            )
            if adjusted.reason:
                return _no_camera(matches, f"bundle adjustment: {adjusted.reason}")
            camera, fundamental = adjusted.camera, adjusted.fundamental
            depths[chosen] = adjusted.depths
            good = outliers.reprojection(points.second, adjusted.second, settings.max_reprojection_px)
            good &= adjusted.in_front
            kept[chosen[~good]] = False
            if good.all() or np.count_nonzero(kept) < settings.min_num_points:
                break
        return CameraPair(camera, fundamental, kept)


class ColmapBackend:
    """LO-RANSAC, relative pose and its refinement by COLMAP, with an estimated focal length."""

    def calibrate(
        self, matches: Correspondences, settings: SfmSettings, rng: np.random.Generator
    ) -> WeakCalibration:
        """Find the fundamental matrix; see `sfm.pycolmap_bridge.estimate_fundamental`.

        Parameters
        ----------
        matches : Correspondences
            Outliers included.
        settings : SfmSettings
            Parameters.
        rng : Generator
            Source of randomness.

        Returns
        -------
        WeakCalibration
            The matrix, or the reason why there is none.
        """
        found = pycolmap_bridge.estimate_fundamental(matches, settings.colmap_max_error_px, _seed(rng))
        least = settings.weak_calibration.min_num_inliers
        if found is None or np.count_nonzero(found[1]) < least:
            nothing = np.zeros(len(matches), dtype=bool)
            reason = f"COLMAP finds no epipolar geometry in {len(matches)} correspondences"
            return WeakCalibration(np.zeros((3, 3)), nothing, np.full(len(matches), np.inf), 0.0, 0, reason)
        fundamental, inliers = found
        residuals = sampson_distances(fundamental, matches.first, matches.second)
        noise_px = float(np.sqrt((residuals[inliers] ** 2).mean()))
        return WeakCalibration(fundamental, inliers, residuals, noise_px, 0, "")

    def cameras(
        self,
        matches: Correspondences,
        calibration: WeakCalibration,
        frame: PixelFrame,
        settings: SfmSettings,
        rng: np.random.Generator,
    ) -> CameraPair:
        """Estimate focal length and relative pose; see `sfm.pycolmap_bridge.estimate_pair`.

        Parameters
        ----------
        matches : Correspondences
            Reliable points, in pixels.
        calibration : WeakCalibration
            Not used: the pose is estimated from the points.
        frame : PixelFrame
            Size of the images.
        settings : SfmSettings
            Parameters.
        rng : Generator
            Source of randomness.

        Returns
        -------
        CameraPair
            The camera, or the reason why there is none.
        """
        del calibration
        pair = pycolmap_bridge.estimate_pair(matches, frame, settings.colmap_max_error_px, _seed(rng))
        if pair is None:
            return _no_camera(matches, "COLMAP finds no relative pose")
        camera = pair.second_camera
        first, second = frame.to_normalized(matches.first), frame.to_normalized(matches.second)
        depth_first, depth_second = triangulate_depth(first, camera, second)
        in_front = (
            np.isfinite(depth_first) & np.isfinite(depth_second) & (depth_first > 0) & (depth_second > 0)
        )
        depths = np.where(in_front, depth_first, 1.0)
        points = np.column_stack([depths[:, None] * homogeneous(first), np.ones(len(matches))])
        projected = frame.to_pixels(project(camera, points)[0])
        kept = in_front & outliers.reprojection(matches.second, projected, settings.max_reprojection_px)
        return CameraPair(camera, pair.fundamental, kept)


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**31 - 1))


def _no_camera(matches: Correspondences, reason: str) -> CameraPair:
    return CameraPair(np.eye(3, 4), np.zeros((3, 3)), np.zeros(len(matches), dtype=bool), reason)


BACKENDS: dict[str, Backend] = {"native": NativeBackend(), "colmap": ColmapBackend()}
"""Backends by the name that the configuration uses."""
