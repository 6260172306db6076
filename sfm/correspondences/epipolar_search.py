"""Searches on epipolar lines: where points of the first key frame are in the second, and on which surface."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sfm.correspondences.subpixel import check_pair, half_pixel_samples, inside, spline, window
from sfm.estimation.epipolar import epipoles
from sfm.scene_model import Correspondences

if TYPE_CHECKING:
    from sfm.correspondences._kernels import KeyPair

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class SearchSettings:
    """How epipolar lines are searched."""

    radius_px: int = 3  # half size of the neighbourhoods compared
    # half range and step of the full search on the epipolar line, tolerance of the golden-section search
    search_px: float = 2.0
    step_px: float = 0.5
    tolerance_px: float = 0.02
    min_error: float = 8.0  # mean squared error that noise and sampling alone can cause, squared luma levels
    error_share: float = 0.06  # largest error beyond, as a share of the variance of the neighbourhood
    # distance from the edge of the two neighbourhoods that tell on which side its surface is
    side_distance_px: float = 5.0
    side_radius_px: int = 2  # half size of these
    side_search_px: float = 6.0  # half range in which they look for a motion of their own
    side_ratio: float = 1.2  # how much worse one side must agree with the edge's motion than the other
    settling_px: float = 1.0  # half range of the search after a point has been moved to its side
    # how far the small neighbourhood of a corner may be from where the large one is
    confirmed_px: float = 0.5

    def __post_init__(self) -> None:
        """Check the ranges."""
        if min(self.radius_px, self.side_radius_px) < 1:
            raise ValueError(f"radii must be at least 1, got {self}")
        if min(self.search_px, self.step_px, self.tolerance_px, self.settling_px) <= 0:
            raise ValueError(f"ranges, step and tolerance of the search must be positive, got {self}")


class EpipolarSearch:
    """Two key frames and their epipolar geometry, ready to be searched."""

    def __init__(
        self, luma0: Image, luma1: Image, fundamental: Floats, settings: SearchSettings | None = None
    ) -> None:
        check_pair(luma0, luma1)
        self.luma0, self.luma1, self.fundamental = luma0, luma1, fundamental
        self.settings = settings or SearchSettings()
        self.usable = bool(np.isfinite(fundamental).all() and np.abs(fundamental).max() > 0)
        self.epipole = epipoles(fundamental)[0] if self.usable else np.zeros(3)
        self._image, self._coefficients = luma0.astype(np.float64), spline(luma1)
        self._halves = half_pixel_samples(self._coefficients)

    @property
    def pair(self) -> "KeyPair":
        """What the kernels take."""
        from sfm.correspondences._kernels import KeyPair

        return KeyPair(self._image, self._coefficients, self._halves, self.fundamental, self.epipole)

    @property
    def line_search(self) -> Floats:
        """Half range, step and tolerance of the usual search."""
        settings = self.settings
        return np.array([settings.search_px, settings.step_px, settings.tolerance_px])

    def inside_both(self, correspondences: Correspondences) -> Mask:
        """Tell which correspondences are finite and inside both frames."""
        first, second = correspondences.first, correspondences.second
        return correspondences.finite & inside(first, self.luma0, 0.0) & inside(second, self.luma0, 0.0)

    def facing_similarities(self, first: Floats, second: Floats) -> Floats:
        """Find how neighbourhoods turn and scale between the frames if surfaces face the cameras."""
        from sfm.correspondences import _kernels

        affines = np.empty((len(first), 2, 2))
        _kernels.similarities(self.fundamental, self.epipole, first, second, affines)
        return affines

    def settle_on_surfaces(self, correspondences: Correspondences) -> Correspondences:
        """Check that points move like their surroundings; move those that lie beside what they move with."""
        from sfm.correspondences import _kernels

        correspondences = correspondences[self.inside_both(correspondences)]
        if len(correspondences) == 0 or not self.usable:
            return correspondences
        first, again = np.rint(correspondences.first).astype(np.int64), correspondences.second.copy()
        error, small = np.empty(len(first)), window(self.settings.side_radius_px)
        points, limit = _kernels.Points(first, again, error), _kernels.ErrorLimit(np.inf, 0.0)
        _kernels.follow_all(self.pair, points, small, self.line_search, limit)
        moved = np.sqrt(((again - correspondences.second) ** 2).sum(axis=1))
        same = np.isfinite(error) & (moved <= self.settings.confirmed_px)
        chosen = correspondences[same]
        return self.settle_sides(first[same], chosen.second, chosen.error)

    def settle_sides(self, first: Indices, second: Floats, error: Floats) -> Correspondences:
        """Move points that lie beside the surface that they move with by a pixel, and search them again."""
        from sfm.correspondences import _kernels

        settings, scores = self.settings, np.empty((len(first), 2))
        normals = gradient_directions(self.luma0)[first[:, 1], first[:, 0]]
        reach, small = settings.side_distance_px, window(settings.side_radius_px)
        _kernels.disagreement(
            self.pair, first, second, normals, reach, small, settings.side_search_px, scores
        )
        plus, minus = np.nan_to_num(scores, nan=1.0).T
        sign = np.where((minus > 1.0) & (minus > settings.side_ratio * plus), 1, 0)
        sign -= (plus > 1.0) & (plus > settings.side_ratio * minus)
        moved = np.flatnonzero(sign)
        step = np.rint(1.2 * sign[moved, None] * normals[moved]).astype(np.int64)
        shifted, there, renewed = first[moved] + step, second[moved] + step, np.empty(len(moved))
        search = np.array([settings.settling_px, settings.step_px, settings.tolerance_px])
        limit = _kernels.ErrorLimit(settings.min_error, settings.error_share)
        points = _kernels.Points(shifted, there, renewed)
        _kernels.follow_all(self.pair, points, window(settings.radius_px), search, limit)
        first, second, error = first.copy(), second.copy(), error.copy()
        first[moved], second[moved], error[moved] = shifted, there, renewed
        order = np.argsort(error, kind="stable")
        order = order[np.isfinite(error[order])]
        _, once = np.unique(first[order], axis=0, return_index=True)
        kept = np.sort(order[once])
        return Correspondences(first[kept].astype(np.float64), second[kept], error[kept])


def gradient_directions(luma: Image) -> Floats:
    """Find the directions of the gradient of a blurred frame."""
    import cv2

    smooth = cv2.GaussianBlur(luma, (3, 3), 0)
    gradient = np.stack([cv2.Sobel(smooth, cv2.CV_64F, 1, 0), cv2.Sobel(smooth, cv2.CV_64F, 0, 1)], axis=-1)
    length = np.sqrt((gradient**2).sum(axis=-1, keepdims=True))
    directions: Floats = gradient / np.maximum(length, 1e-9)
    return directions


def far_from(points: Floats, others: Floats, distance_px: float) -> Mask:
    """Tell which points have no other near them."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(others).query(points)[0] > distance_px)
