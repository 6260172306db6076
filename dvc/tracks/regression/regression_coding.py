"""Coding of point tracks by regression: both ends estimate the motion of an instant from the tracks so far.

The predicted motion of a track is linear in its position, its past motion and products of both coordinates of
its position. Recursive least squares estimate the coefficients from the tracks coded before it at the same
instant; the residuals of its neighbours are added. First positions are coded as occupied cells of a grid.

References
----------
S. Haykin, "Adaptive Filter Theory", 2002, chapter 9: recursive least squares.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig
from dvc.entropy import RangeCoder
from dvc.entropy.mixing import SQUASH, STRETCH_LIMIT, TABLE_SIZE, logistic_tables
from dvc.errors import BitstreamError
from dvc.tracks._kernels import LOST
from dvc.tracks.point_sets import num_positions
from dvc.tracks.regression import _kernels
from dvc.tracks.regression._kernels import Models

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

NUM_FEATURES, NUM_NEIGHBOURS = _kernels.NUM_FEATURES, _kernels.NUM_NEIGHBOURS
"""Number of features of the motion of a track, and of nearby tracks with errors that are used."""
ROW_FEATURES = _kernels.STRIDE
"""Features in a row of the covariance, zeros at its end included."""

_LOST = ((1.0, 4.0), (1.0, 16.0), (1.0, 26.0))
_LOST_BACKWARD = ((1.0, 4.0), (1.0, 9.0), (1.0, 9.0))
_POINTS_TOLD = ((2.0, 4.0), (3.6, 4.0), (4.4, 4.0), (5.2, 4.0))
_LEVEL = 0.6
_AREA_OF_REACH = 69


def code_tracks(
    coder: RangeCoder, forward: Integers, backward: Integers, config: CodecConfig
) -> tuple[Integers, Integers]:
    """Code tracks, each in its own direction of time."""
    bound = config.tracks.num_points + 1
    num_forward, num_backward = (coder.uniform(bound, len(tracks)) for tracks in (forward, backward))
    models = _models()
    none = np.empty((0, forward.shape[1], 2), np.int64)
    sent = _code_direction(coder, models, none, forward[:num_forward], config)
    given = np.ascontiguousarray(sent[sent[:, -1, 0] != LOST, ::-1])
    models = models._replace(losses=np.array(_LOST_BACKWARD))
    return sent, _code_direction(coder, models, given, backward[:num_backward], config)


def _models() -> Models:
    return Models(_initial_curves().copy(), logistic_tables(), np.array(_LOST))


@cache
def _initial_curves() -> Floats:
    nodes = _kernels.NODE_STEP * np.arange(_kernels.NUM_NODES) - _kernels.NODE_LIMIT
    places = ((nodes + STRETCH_LIMIT) * (TABLE_SIZE / (2 * STRETCH_LIMIT))).astype(np.int64)
    return np.tile(logistic_tables()[SQUASH, places], (_kernels.NUM_STAGES, 1))


def _code_direction(
    coder: RangeCoder, models: Models, given: Integers, tracks: Integers, config: CodecConfig
) -> Integers:
    """Code tracks after given ones, and return the coded ones."""
    if len(tracks) == 0:
        return tracks
    tracks = tracks.copy()
    first, taken = (np.ascontiguousarray(some[:, 0]) for some in (tracks, given))
    _code_first(coder, first, taken, num_positions(config))
    tracks[:, 0] = first
    return _code_motion(coder, models, given, tracks, config)


def _code_motion(
    coder: RangeCoder, models: Models, given: Integers, tracks: Integers, config: CodecConfig
) -> Integers:
    """Code tracks from known starts."""
    sides = num_positions(config)
    reach = max(sides[0] * sides[1] / _AREA_OF_REACH, 1.0)
    order, units, motion = _kernels.begin_motion(given, tracks, reach, _LEVEL)
    picture = _kernels.Picture(np.array(sides), float(2**config.tracks.subpixel_bits))
    t = 1
    while t < units.shape[1]:
        state = coder.room_for(len(units) * _kernels.MAX_SYMBOLS)
        t = _kernels.code_instants(state, models, motion, units, t, len(given), picture)
        coder.check()
        if t == _kernels.OUTSIDE:
            raise BitstreamError("a track leaves the frame")
    coded: Integers = np.empty_like(units[len(given) :])
    coded[order] = units[len(given) :]
    return coded


def _code_first(coder: RangeCoder, points: Integers, taken: Integers, sides: tuple[int, int]) -> None:
    """Code where tracks begin, away from where those are that are given."""
    state = coder.room_for(min(sides[0] * sides[1], _kernels.MAX_CELLS) + 2 * len(points) + 3)
    if not _kernels.code_first(state, points, taken, sides, np.array(_POINTS_TOLD)):
        raise BitstreamError("a frame has no room for its points")
    coder.check()
