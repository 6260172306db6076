"""Snakes: curves between two key frames that are drawn to the points received for the frames between.

Each correspondence spans a curve over time. Near received points pull at it, the closer the more; curves
bend little in time, and neighbours in the image deviate alike: linear least squares, as in mesh fitting,
solved again as the curves come closer to their points.

References
----------
[Maitre2008] Sec. 5.4.2; equations as (5.10).
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from decoder.tracking.registration import mutual_matches

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class SnakeSettings:
    """How snakes are fitted.

    Attributes
    ----------
    radii_px : tuple of float
        Distance beyond which points are ignored, from one fit to the next.
    distance_px : float
        From here on the weight of a point decreases as the square of its distance.
    bending : float
        Weight of the second difference in time (mu^2).
    coupling : float
        Weight of the difference between neighbours that are close in place and motion (mu^2).
    near_px : float
        Neighbours that are this far apart are coupled half as much.
    alike_px : float
        So are neighbours whose motion differs by this much.
    ridge : float
        Weight that holds snakes which nothing determines.
    """

    radii_px: tuple[float, ...] = (4.0, 3.0, 2.5, 2.0)
    distance_px: float = 1.0
    bending: float = 0.1
    coupling: float = 1.0
    near_px: float = 40.0
    alike_px: float = 4.0
    ridge: float = 0.02


class Snakes(NamedTuple):
    """Curves between two key frames.

    Attributes
    ----------
    positions : ndarray of shape (N, T, 2), float64
        Each curve at the frames between the key frames, in pixels.
    received : ndarray of shape (N, T, 2), float64
        The received point that belongs to each, nan where there is none.
    """

    positions: Floats
    received: Floats


def fit_snakes(
    first: Floats, second: Floats, expected: Floats, frames: list[Floats], settings: SnakeSettings
) -> Snakes:
    """Draw snakes to received points.

    Parameters
    ----------
    first, second : ndarray of shape (N, 2), float64
        Corresponding points of the key frames, in pixels.
    expected : ndarray of shape (N, T, 2), float64
        Where the snakes start in the frames between the key frames.
    frames : list of ndarray of shape (M, 2), float64
        Points received for each of these T frames.
    settings : SnakeSettings
        Weights and distances.

    Returns
    -------
    Snakes
        The curves, and the points that they found.
    """
    deviation = np.zeros_like(expected)
    smooth = _smoothness(first, second, len(frames), settings)
    for radius in settings.radii_px:
        deviation = _fit_once(expected, deviation, frames, smooth, radius, settings)
    positions = expected + deviation
    return Snakes(positions, _received(positions, frames, settings.radii_px[-1]))


def _received(positions: Floats, frames: list[Floats], radius: float) -> Floats:
    found = np.full(positions.shape, np.nan)
    for k, points in enumerate(frames):
        chosen, nearest, _ = mutual_matches(positions[:, k], points, radius)
        found[chosen, k] = points[nearest]
    return found


def _fit_once(
    expected: Floats,
    deviation: Floats,
    frames: list[Floats],
    smooth: Any,
    radius: float,
    settings: SnakeSettings,
) -> Floats:
    """Solve for all deviations, snake by snake and frame by frame: unknown `i * T + k`."""
    from scipy import sparse
    from scipy.sparse.linalg import spsolve

    target = _received(expected + deviation, frames, radius)
    seen = np.isfinite(target[..., 0])
    pull = np.where(seen[..., None], target, expected) - expected
    squared = ((pull - deviation) ** 2).sum(axis=2)
    weight = np.where(seen, 1.0 / (squared / settings.distance_px**2 + 1.0), 0.0)
    system = (smooth + sparse.diags_array(weight.ravel())).tocsc()
    right = (weight[..., None] * pull).reshape(-1, 2)
    solution = spsolve(system, right)
    return np.asarray(solution, dtype=np.float64).reshape(deviation.shape)


def _smoothness(first: Floats, second: Floats, num_frames: int, settings: SnakeSettings) -> Any:
    """Return the matrix (N T, N T) of all terms that do not depend on the received points."""
    from scipy import sparse

    count = len(first)
    line = sparse.diags_array([1.0, -2.0, 1.0], offsets=[-1, 0, 1], shape=(num_frames, num_frames))
    bending = sparse.kron(sparse.eye_array(count), settings.bending * (line.T @ line))
    edges = neighbours(0.5 * (first + second))
    a, b = edges.T
    apart = ((first[a] + second[a] - first[b] - second[b]) ** 2).sum(axis=1) / 4.0
    unlike = ((second[a] - first[a] - second[b] + first[b]) ** 2).sum(axis=1)
    weight = 1.0 / ((1.0 + apart / settings.near_px**2) * (1.0 + unlike / settings.alike_px**2))
    incidence = sparse.csr_array(
        (np.repeat([1.0, -1.0], len(edges)), (np.tile(np.arange(len(edges)), 2), np.concatenate([a, b]))),
        shape=(len(edges), count),
    )
    laplacian = settings.coupling * (incidence.T @ sparse.diags_array(weight) @ incidence)
    coupling = sparse.kron(laplacian, sparse.eye_array(num_frames))
    return bending + coupling + settings.ridge * sparse.eye_array(count * num_frames)


def neighbours(points: Floats) -> Indices:
    """Return the edges of a Delaunay triangulation.

    Parameters
    ----------
    points : ndarray of shape (N, 2), float64
        Places in pixels.

    Returns
    -------
    ndarray of shape (E, 2), int64
        Pairs of points, each once, the smaller index first; points on a line are chained.
    """
    from scipy.spatial import Delaunay, QhullError

    try:
        corners = np.sort(Delaunay(points).simplices.astype(np.int64), axis=1)
        pairs = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [0, 2]]])
    except (QhullError, ValueError):
        order = np.lexsort((points[:, 1], points[:, 0]))
        pairs = np.sort(np.column_stack([order[:-1], order[1:]]), axis=1)
    return np.unique(pairs, axis=0)
