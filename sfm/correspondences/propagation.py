"""Correspondences along the edges of the first key frame, under the epipolar constraint."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfm.correspondences.epipolar_search import EpipolarSearch, far_from, gradient_directions
from sfm.correspondences.refinement import window
from sfm.model import Correspondences

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class PropagationSettings:
    """How correspondences spread along edges."""

    canny_low: float = 6.0  # thresholds of the edge detector on Sobel gradients, 4 to a luma level per pixel
    canny_high: float = 18.0
    reach_px: int = 4  # edge points this near a known correspondence are tried
    num_tries: int = 2  # how often one edge point may be tried from different neighbours
    min_sine: float = 0.3  # least sine of the angle between edge and epipolar line
    min_epipole_distance_px: float = 12.0  # edge points nearer to the epipole are left out

    def __post_init__(self) -> None:
        """Check the ranges."""
        if min(self.reach_px, self.num_tries) < 1:
            raise ValueError(f"`reach_px` and `num_tries` must be at least 1, got {self}")


def propagate(
    search: EpipolarSearch, correspondences: Correspondences, settings: PropagationSettings | None = None
) -> Correspondences:
    """Spread correspondences along the edges of the first key frame, under the epipolar constraint."""
    from sfm.correspondences import _kernels

    settings = settings or PropagationSettings()
    seeds = correspondences[search.inside_both(correspondences)]
    if len(seeds) == 0 or not search.usable:
        return correspondences
    tries = np.where(_crossing_edges(search, settings), settings.num_tries, 0)
    num_seeds, room = len(seeds), len(seeds) + tries.size
    first, second, error = np.empty((room, 2), dtype=np.int64), np.empty((room, 2)), np.empty(room)
    first[:num_seeds] = np.rint(seeds.first)
    second[:num_seeds] = first[:num_seeds] + seeds.motion
    tries[first[:num_seeds, 1], first[:num_seeds, 0]] = 0
    end = _kernels.propagate(
        search.pair,
        tries,
        settings.reach_px,
        window(search.settings.radius_px),
        search.line_search,
        _kernels.ErrorLimit(search.settings.min_error, search.settings.error_share),
        num_seeds,
        _kernels.Points(first, second, error),
    )
    added = slice(num_seeds, end)
    new = search.settle_sides(first[added].copy(), second[added].copy(), error[added])
    new = new[far_from(new.first, seeds.first, 0.5)]
    return Correspondences.concatenate([correspondences, new])


def find_edges(luma: Image, settings: PropagationSettings) -> Mask:
    """Find edges with Canny's detector."""
    import cv2

    smooth = cv2.GaussianBlur(luma, (3, 3), 0)
    return np.asarray(cv2.Canny(smooth, settings.canny_low, settings.canny_high, L2gradient=True) > 0)


def _crossing_edges(search: EpipolarSearch, settings: PropagationSettings) -> Mask:
    """Choose edge points that are far from the epipole and on edges that epipolar lines cross."""
    edges, normals = find_edges(search.luma0, settings), gradient_directions(search.luma0)
    epipole = search.epipole
    rows, columns = np.indices(edges.shape)
    x, y = epipole[0] - columns * epipole[2], epipole[1] - rows * epipole[2]
    length = np.sqrt(x * x + y * y)
    far = length >= settings.min_epipole_distance_px * abs(epipole[2])
    across = np.abs(normals[..., 0] * x + normals[..., 1] * y) >= settings.min_sine * length
    return np.asarray(edges & far & across)
