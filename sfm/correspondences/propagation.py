"""Correspondences along the edges of the first key frame, and the surfaces that edge points belong to."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sfm.correspondences.refinement import check_pair, inside, spline_coefficients, window
from sfm.estimation.epipolar import epipoles
from sfm.model import Correspondences

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class PropagationSettings:
    """How correspondences spread along edges.

    Attributes
    ----------
    canny_low, canny_high : float
        Thresholds of the edge detector on Sobel gradients, 4 to a luma level per pixel.
    reach_px : int
        Edge points this near a known correspondence are tried.
    num_tries : int
        How often one edge point may be tried from different neighbours.
    radius_px : int
        Half size of the neighbourhoods compared.
    search_px, step_px, tolerance_px : float
        Half range and step of the full search on the epipolar line, tolerance of the golden-section search.
    min_sine : float
        Least sine of the angle between edge and epipolar line.
    min_epipole_distance_px : float
        Edge points nearer to the epipole are left out.
    least_error : float
        Mean squared error that noise and sampling alone can cause, squared luma levels.
    error_share : float
        Largest error beyond, as a share of the variance of the neighbourhood.
    side_distance_px : float
        Distance from the edge of the two neighbourhoods that tell on which side its surface is.
    side_radius_px : int
        Half size of these.
    side_search_px : float
        Half range in which they look for a motion of their own.
    side_ratio : float
        How much worse one side must agree with the edge's motion than the other.
    settling_px : float
        Half range of the search after a point has been moved to its side.
    confirmed_px : float
        How far the small neighbourhood of a corner may be from where the large one is.
    """

    canny_low: float = 6.0
    canny_high: float = 18.0
    reach_px: int = 4
    num_tries: int = 2
    radius_px: int = 3
    search_px: float = 2.0
    step_px: float = 0.5
    tolerance_px: float = 0.02
    min_sine: float = 0.3
    min_epipole_distance_px: float = 12.0
    least_error: float = 8.0
    error_share: float = 0.06
    side_distance_px: float = 5.0
    side_radius_px: int = 2
    side_search_px: float = 6.0
    side_ratio: float = 1.2
    settling_px: float = 1.0
    confirmed_px: float = 0.5

    def __post_init__(self) -> None:
        """Check the ranges."""
        if min(self.reach_px, self.num_tries, self.radius_px, self.side_radius_px) < 1:
            raise ValueError(f"reach, number of tries and radii must be at least 1, got {self}")
        if min(self.search_px, self.step_px, self.tolerance_px, self.settling_px) <= 0:
            raise ValueError(f"ranges, step and tolerance of the search must be positive, got {self}")


def settle_on_surfaces(
    luma0: Image,
    luma1: Image,
    fundamental: Floats,
    correspondences: Correspondences,
    settings: PropagationSettings | None = None,
) -> Correspondences:
    """Check that points move like their surroundings, and move those that lie beside what they move with.

    The neighbourhood of a corner on an occluding edge follows the nearer surface, while the point itself
    may lie on the farther one, or belong to neither.

    Parameters
    ----------
    luma0, luma1 : ndarray of shape (H, W), uint8
        Key frames.
    fundamental : ndarray of shape (3, 3), float64
        F with ``x1' F x0 = 0`` in pixels.
    correspondences : Correspondences
        Candidates, first points at whole pixels.
    settings : PropagationSettings, optional
        Neighbourhoods beside edges.

    Returns
    -------
    Correspondences
        Those whose small neighbourhood finds the same place on its epipolar line; some moved by one pixel.
    """
    from sfm.correspondences import _kernels

    settings = settings or PropagationSettings()
    check_pair(luma0, luma1)
    correspondences = correspondences[_inside_both(correspondences, luma0)]
    if len(correspondences) == 0 or not usable(fundamental):
        return correspondences
    view = _View(luma0.astype(np.float64), spline_coefficients(luma1), fundamental, epipoles(fundamental)[0])
    first, again = np.rint(correspondences.first).astype(np.int64), correspondences.second.copy()
    error = np.empty(len(first))
    search = np.array([settings.search_px, settings.step_px, settings.tolerance_px])
    small = window(settings.side_radius_px)
    _kernels.follow_all(*view.arrays, first, again, small, search, np.inf, 0.0, error)
    moved = np.sqrt(((again - correspondences.second) ** 2).sum(axis=1))
    same = np.isfinite(error) & (moved <= settings.confirmed_px)
    normals = find_edges(luma0, settings)[1][first[same, 1], first[same, 0]]
    chosen = correspondences[same]
    return _settle_sides(view, first[same], chosen.second, chosen.error, normals, settings)


def propagate(
    luma0: Image,
    luma1: Image,
    fundamental: Floats,
    correspondences: Correspondences,
    settings: PropagationSettings | None = None,
) -> Correspondences:
    """Spread correspondences along the edges of the first key frame, under the epipolar constraint.

    Edge points around known correspondences take the motion of the nearest, search their epipolar line
    nearby, and become known themselves if they are similar enough. Neighbourhoods of the second frame are
    scaled and turned as the epipolar lines demand. On occluding edges, a point moves with the nearer
    surface but may lie on the farther one: it is then moved by one pixel, to the side that moves like it.

    Parameters
    ----------
    luma0, luma1 : ndarray of shape (H, W), uint8
        Key frames.
    fundamental : ndarray of shape (3, 3), float64
        F with ``x1' F x0 = 0`` in pixels.
    correspondences : Correspondences
        Reliable ones.
    settings : PropagationSettings, optional
        Edges, search, and what is rejected.

    Returns
    -------
    Correspondences
        The given ones, then the new ones, at whole pixels of the first frame.

    References
    ----------
    [Maitre2008] Sec. 5.2.4, Correspondence propagation.
    """
    from sfm.correspondences import _kernels

    settings = settings or PropagationSettings()
    check_pair(luma0, luma1)
    seeds = correspondences[_inside_both(correspondences, luma0)]
    if len(seeds) == 0 or not usable(fundamental):
        return correspondences
    edges, normals = find_edges(luma0, settings)
    tries = np.where(_crosses_lines(edges, normals, fundamental, settings), settings.num_tries, 0)
    num_seeds, room = len(seeds), len(seeds) + luma0.size
    first, second, error = np.empty((room, 2), dtype=np.int64), np.empty((room, 2)), np.empty(room)
    first[:num_seeds] = np.rint(seeds.first)
    second[:num_seeds] = first[:num_seeds] + seeds.motion
    tries[first[:num_seeds, 1], first[:num_seeds, 0]] = 0
    view = _View(luma0.astype(np.float64), spline_coefficients(luma1), fundamental, epipoles(fundamental)[0])
    end = _kernels.propagate(
        *view.arrays,
        tries,
        settings.reach_px,
        window(settings.radius_px),
        np.array([settings.search_px, settings.step_px, settings.tolerance_px]),
        settings.least_error,
        settings.error_share,
        num_seeds,
        first,
        second,
        error,
    )
    found = first[num_seeds:end].copy()
    normal = normals[found[:, 1], found[:, 0]]
    new = _settle_sides(view, found, second[num_seeds:end].copy(), error[num_seeds:end], normal, settings)
    new = new[far_from(new.first, seeds.first, 0.5)]
    return Correspondences.concatenate([correspondences, new])


@dataclass(frozen=True, eq=False)
class _View:
    """What every search needs: first image, spline coefficients of the second, F, first epipole."""

    image: Floats
    coefficients: Floats
    fundamental: Floats
    epipole: Floats

    @property
    def arrays(self) -> tuple[Floats, Floats, Floats, Floats]:
        return self.image, self.coefficients, self.fundamental, self.epipole


def _inside_both(correspondences: Correspondences, luma: Image) -> Mask:
    """Tell which correspondences are finite and inside both frames."""
    within = inside(correspondences.first, luma, 0.0) & inside(correspondences.second, luma, 0.0)
    return correspondences.finite & within


def usable(fundamental: Floats) -> bool:
    """Tell whether a matrix can serve as F: finite and not zero.

    Parameters
    ----------
    fundamental : ndarray of shape (3, 3), float64
        Candidate.

    Returns
    -------
    bool
        False if there is no epipolar geometry in it.
    """
    return bool(np.isfinite(fundamental).all() and np.abs(fundamental).max() > 0)


def find_edges(luma: Image, settings: PropagationSettings) -> tuple[Mask, Floats]:
    """Find edges with Canny's detector.

    Parameters
    ----------
    luma : ndarray of shape (H, W), uint8
        Frame.
    settings : PropagationSettings
        Thresholds.

    Returns
    -------
    edges : ndarray of shape (H, W), bool
        True on an edge.
    normals : ndarray of shape (H, W, 2), float64
        Unit vectors (x, y) of the gradient; zero where it is.
    """
    import cv2

    smooth = cv2.GaussianBlur(luma, (3, 3), 0)
    edges = cv2.Canny(smooth, settings.canny_low, settings.canny_high, L2gradient=True) > 0
    gradient = np.stack([cv2.Sobel(smooth, cv2.CV_64F, 1, 0), cv2.Sobel(smooth, cv2.CV_64F, 0, 1)], axis=-1)
    length = np.sqrt((gradient**2).sum(axis=-1, keepdims=True))
    return edges, gradient / np.maximum(length, 1e-9)


def _crosses_lines(edges: Mask, normals: Floats, fundamental: Floats, settings: PropagationSettings) -> Mask:
    """Choose edge points that are far from the epipole and on edges that epipolar lines cross."""
    epipole = epipoles(fundamental)[0]
    rows, columns = np.indices(edges.shape)
    x, y = epipole[0] - columns * epipole[2], epipole[1] - rows * epipole[2]
    length = np.sqrt(x * x + y * y)
    far = length >= settings.min_epipole_distance_px * abs(epipole[2])
    across = np.abs(normals[..., 0] * x + normals[..., 1] * y) >= settings.min_sine * length
    return np.asarray(edges & far & across)


def _settle_sides(
    view: _View,
    first: Indices,
    second: Floats,
    error: Floats,
    normals: Floats,
    settings: PropagationSettings,
) -> Correspondences:
    """Move points that lie beside the surface that they move with, and search them again."""
    from sfm.correspondences import _kernels

    scores = np.empty((len(first), 2))
    _kernels.disagreement(
        *view.arrays,
        first,
        second,
        normals,
        settings.side_distance_px,
        window(settings.side_radius_px),
        settings.side_search_px,
        scores,
    )
    plus, minus = np.nan_to_num(scores, nan=1.0).T
    sign = np.where((minus > 1.0) & (minus > settings.side_ratio * plus), 1, 0)
    sign -= (plus > 1.0) & (plus > settings.side_ratio * minus)
    moved = np.flatnonzero(sign)
    step = np.rint(1.2 * sign[moved, None] * normals[moved]).astype(np.int64)
    shifted, there, renewed = first[moved] + step, second[moved] + step, np.empty(len(moved))
    _kernels.follow_all(
        *view.arrays,
        shifted,
        there,
        window(settings.radius_px),
        np.array([settings.settling_px, settings.step_px, settings.tolerance_px]),
        settings.least_error,
        settings.error_share,
        renewed,
    )
    first, second, error = first.copy(), second.copy(), error.copy()
    first[moved], second[moved], error[moved] = shifted, there, renewed
    order = np.argsort(error, kind="stable")
    order = order[np.isfinite(error[order])]
    _, once = np.unique(first[order], axis=0, return_index=True)
    kept = np.sort(order[once])
    return Correspondences(first[kept].astype(np.float64), second[kept], error[kept])


def far_from(points: Floats, others: Floats, distance_px: float) -> Mask:
    """Tell which points have no other near them.

    Parameters
    ----------
    points, others : ndarray of shape (N, 2) and (M, 2), float64
        Image points in pixels.
    distance_px : float
        What is near.

    Returns
    -------
    ndarray of shape (N,), bool
        True for points without.
    """
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(others).query(points)[0] > distance_px)


def facing_similarities(fundamental: Floats, first: Floats, second: Floats) -> Floats:
    """Find how neighbourhoods turn and scale between the frames if surfaces face the cameras.

    Parameters
    ----------
    fundamental : ndarray of shape (3, 3), float64
        F with ``x1' F x0 = 0`` in pixels.
    first, second : ndarray of shape (N, 2), float64
        Correspondences in pixels.

    Returns
    -------
    ndarray of shape (N, 2, 2), float64
        Maps of offsets from the first points to offsets from the second, scales within [0.5, 2].
    """
    from sfm.correspondences import _kernels

    affines = np.empty((len(first), 2, 2))
    _kernels.similarities(fundamental, epipoles(fundamental)[0], first, second, affines)
    return affines
