"""Rows of matches after rectification, beside those of OpenCV's functions."""

import tempfile
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.stereo.calibrations import write_cameras
from benchmarks.figures.stereo.runs import data_folder
from dvc.calibration.camera_files import load_cameras
from dvc.calibration.cameras import Camera
from dvc.calibration.feature_matching import Features
from dvc.picture_files import read_picture
from dvc.stereo.rectification.rectified_array import rectified_array

AREA = "stereo"
SETS = ("sport", "ballet")
MAX_ERROR_PX = 1.5
"""Of matches, from their epipolar lines: the others are wrong."""
Floats = NDArray[np.float64]


def row_rms(first: Floats, second: Floats) -> float:
    """Return how far rows of matches are apart."""
    return float(np.sqrt(np.mean((first[:, 1] - second[:, 1]) ** 2)))


def _calibrated(cameras: tuple[Camera, ...], first: Floats, second: Floats) -> float:
    """Rectify by `cv2.stereoRectify`."""
    left, right = cameras
    turn = right.R @ left.R.T
    shift = right.t - turn @ left.t
    nothing = np.zeros(5)
    R1, R2, P1, P2, *_ = cv2.stereoRectify(left.K, nothing, right.K, nothing, left.size, turn, shift[:, None])
    moved = [
        np.asarray(cv2.undistortPoints(points[:, None], camera.K, nothing, R=R, P=P)[:, 0], np.float64)
        for points, camera, R, P in ((first, left, R1, P1), (second, right, R2, P2))
    ]
    vertical = abs(P2[1, 3]) > abs(P2[0, 3])
    return row_rms(*(points[:, ::-1] if vertical else points for points in moved))


def _uncalibrated(size: tuple[int, int], F: Floats, first: Floats, second: Floats) -> float:
    """Rectify by `cv2.stereoRectifyUncalibrated`."""
    _, H1, H2 = cv2.stereoRectifyUncalibrated(first, second, F, size)
    moved = [
        np.asarray(cv2.perspectiveTransform(points[:, None], H)[:, 0], np.float64)
        for points, H in ((first, H1), (second, H2))
    ]
    return row_rms(*moved)


def rows_of_matches(setting: Setting, clip: str, name: str) -> Measured:
    """Rectify a pair by its calibration, and look at the rows of matches that one epipolar geometry
    explains.
    """
    del setting, clip
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "cameras.json"
        paths = write_cameras(data_folder(name) / name, file)
        pictures = [read_picture(path) for path in paths]
        cameras = load_cameras(file, paths, pictures).cameras
        rectification = rectified_array(paths, file).rectification
    first, second = Features(pictures[0]).match(Features(pictures[1]))
    F, inliers = cv2.findFundamentalMat(first, second, cv2.USAC_MAGSAC, MAX_ERROR_PX, 0.999, 10_000)
    kept = inliers[:, 0] > 0
    first, second = first[kept], second[kept]
    ours = row_rms(rectification.rectified_points(0, first), rectification.rectified_points(1, second))
    theirs = _calibrated(tuple(cameras), first, second)
    by_matches = _uncalibrated(cameras[0].size, np.asarray(F, np.float64), first, second)
    text = (
        f"{ours:.2f} px over {len(first)} matches (stereoRectify {theirs:.2f}, "
        f"stereoRectifyUncalibrated {by_matches:.2f})"
    )
    values = {"rms_px": ours, "stereo_rectify_rms_px": theirs, "uncalibrated_rms_px": by_matches}
    return Measured(text, ours <= theirs, values)


FIGURES = tuple(
    Figure(
        AREA,
        f"rows-{name}",
        f"rows of matches of {name} after rectification, rms",
        "not above stereoRectify's, of the same calibration",
        partial(rows_of_matches, name=name),
    )
    for name in SETS
)
"""The figures of this module."""
