"""Block motion after the motion of the whole frame: each reference is first warped on to the tracked points.

Block motion assumes straight paths at constant speed. Tracked points give the real position of the frame
between its references: a homography per reference, fitted to them, warps both onto the frame, and block
motion estimates the rest. This predicts frames without a model of the scene, as with a camera that only
turns, and complements the model if the scene is not static.
"""

import cv2
import numpy as np

from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.protocol import Prediction, ReferenceFrame
from dvc.arrays import Bytes, Floats
from dvc.geometry.cameras import homogeneous
from dvc.geometry.warping import sample
from dvc.video import Frame
from sfm.decompositions import right_singular

MIN_NUM_POINTS = 12
"""Points that a homography is fitted to at least."""
MIN_AFFINE_POINTS = 6
"""Points that an affine map is fitted to at least; fewer give a translation."""
REACH_PX = 3.0
"""Largest distance of a point from its mapped position in the common motion."""
MAX_CONDITION = 16.0
"""Largest quotient of the scales of a plausible map over a frame."""


def whole_frame_motion(points: Floats, matches: Floats) -> Floats:
    """Fit the common motion of points: a homography, or fewer parameters for few points."""
    known = np.isfinite(points).all(axis=1) & np.isfinite(matches).all(axis=1)
    first, second = points[known], matches[known]
    return _fit(first, second) if len(first) else np.eye(3)


def _fit(first: Floats, second: Floats) -> Floats:
    translation = np.eye(3)
    translation[:2, 2] = np.median(second - first, axis=0)
    if len(first) < MIN_AFFINE_POINTS:
        return translation
    if len(first) >= MIN_NUM_POINTS:
        found, _ = cv2.findHomography(
            first, second, cv2.USAC_MAGSAC, REACH_PX, confidence=0.999, maxIters=2000
        )
        homography = np.eye(3) if found is None else np.asarray(found, dtype=np.float64)
        if found is not None and _is_sane(homography, first):
            return homography
    affine, _ = cv2.estimateAffine2D(first, second, method=cv2.RANSAC, ransacReprojThreshold=REACH_PX)
    if affine is not None:
        whole = np.vstack([affine, [0.0, 0.0, 1.0]])
        if _is_sane(whole, first):
            return whole
    return translation


def _is_sane(homography: Floats, points: Floats) -> bool:
    """Return whether a map neither turns a frame over nor shrinks parts of it implausibly."""
    if not np.isfinite(homography).all():
        return False
    third = homogeneous(points) @ homography[2]
    if third.min() <= 0.0 or third.max() > MAX_CONDITION * third.min():
        return False
    scales, _ = right_singular(homography[:2, :2] / third.mean())
    turned = float(np.linalg.det(homography[:2, :2])) <= 0.0
    return not turned and scales[1] > 1.0 / MAX_CONDITION and scales[0] < MAX_CONDITION


def _apply(homography: Floats, points: Floats) -> Floats:
    image = homogeneous(points) @ homography.T
    third = np.where(np.abs(image[:, 2:]) > 1e-9, image[:, 2:], 1e-9)
    mapped: Floats = image[:, :2] / third
    return mapped


def homography_positions(homography: Floats, shape: tuple[int, ...]) -> Floats:
    """Return the positions of the pixels of a frame under a homography."""
    rows, columns = np.indices(shape)
    points = np.stack([columns.ravel(), rows.ravel()], axis=-1).astype(np.float64)
    limit = 4.0 * max(shape)
    positions: Floats = np.clip(_apply(homography, points), -limit, limit)
    return positions.reshape(*shape, 2)


def warp_frame(frame: Frame, homography: Floats) -> Frame:
    """Warp a frame."""
    luma = _warp(frame.luma, homography)
    if frame.chroma is None:
        return Frame(luma, None)
    # A chroma sample lies half a pixel right of and below its luma sample: only the scale changes.
    halved = np.diag([0.5, 0.5, 1.0]) @ homography @ np.diag([2.0, 2.0, 1.0])
    return Frame(luma, (_warp(frame.chroma[0], halved), _warp(frame.chroma[1], halved)))


def _warp(plane: Bytes, homography: Floats) -> Bytes:
    return np.floor(sample(plane, homography_positions(homography, plane.shape)) + 0.5).astype(np.uint8)


class AlignedBlockMotion:
    """Block-motion interpolation between references that tracked points have brought into place."""

    def __init__(self) -> None:
        self._block_motion = BlockMotionInterpolation()

    def predict(
        self,
        around: tuple[ReferenceFrame, ReferenceFrame],
        instant: int,
        points: tuple[Floats, Floats, Floats],
    ) -> Prediction:
        """Predict one frame."""
        before, wanted, after = points
        warped = []
        for reference, there in zip(around, (before, after), strict=True):
            homography = whole_frame_motion(wanted, there)
            warped.append(ReferenceFrame(reference.index, warp_frame(reference.frame, homography)))
        return self._block_motion.predict(warped, None, [instant])[0]
