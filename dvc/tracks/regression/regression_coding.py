"""Coding of point tracks by regression: both ends estimate the motion of an instant from the tracks so far.

The predicted motion of a track is linear in its position, its past motion and products of both coordinates of
its position. Recursive least squares estimate the coefficients; the residuals of its neighbours are added.
First positions are coded as occupied cells of a grid.

References
----------
S. Haykin, "Adaptive Filter Theory", 2002, chapter 9: recursive least squares.
"""

import numpy as np

from dvc.arrays import Integers
from dvc.config import CodecConfig
from dvc.entropy import RangeCoder
from dvc.entropy.mixing import SQUASH, STRETCH_LIMIT, TABLE_SIZE, logistic_tables
from dvc.errors import BitstreamError
from dvc.tracks import _kernels as points_kernels
from dvc.tracks._kernels import LOST, NODE_STEP, Models
from dvc.tracks.points import num_positions
from dvc.tracks.regression import _kernels

NUM_FEATURES, NUM_NEIGHBOURS, ROW_FEATURES = _kernels.NUM_FEATURES, _kernels.NUM_NEIGHBOURS, _kernels.STRIDE
"""Features of the motion of a track, tracks nearby with errors that are used, features in a padded row."""
_LOST = ((1.0, 4.0), (1.0, 16.0), (1.0, 26.0))
_LOST_BACKWARD = ((1.0, 4.0), (1.0, 9.0), (1.0, 9.0))
_POINTS_BEFORE = ((2.0, 4.0), (3.6, 4.0), (4.4, 4.0), (5.2, 4.0))
_LEVEL = 0.6
_AREA_OF_REACH = 69


def code_tracks(
    coder: RangeCoder, forward: Integers, backward: Integers, config: CodecConfig
) -> tuple[Integers, Integers]:
    """Code tracks, each in its own direction of time."""
    bound = config.tracks.num_points + 1
    num_forward, num_backward = (coder.uniform(bound, len(tracks)) for tracks in (forward, backward))
    nodes = NODE_STEP * np.arange(points_kernels.NUM_NODES) - points_kernels.NODE_LIMIT
    indices = ((nodes + STRETCH_LIMIT) * (TABLE_SIZE / (2 * STRETCH_LIMIT))).astype(np.int64)
    curves = np.tile(logistic_tables()[SQUASH, indices], (points_kernels.NUM_STAGES, 1))
    models = Models(curves, logistic_tables(), np.array(_LOST))
    none = np.empty((0, forward.shape[1], 2), np.int64)
    sent = _code_direction(coder, models, none, forward[:num_forward], config)
    given = np.ascontiguousarray(sent[sent[:, -1, 0] != LOST, ::-1])
    models = models._replace(losses=np.array(_LOST_BACKWARD))
    return sent, _code_direction(coder, models, given, backward[:num_backward], config)


def _code_direction(
    coder: RangeCoder, models: Models, given: Integers, tracks: Integers, config: CodecConfig
) -> Integers:
    """Code tracks after given ones, and return the coded ones: first all starts, then the motion."""
    if len(tracks) == 0:
        return tracks
    tracks, sides = tracks.copy(), num_positions(config)
    first, taken = (np.ascontiguousarray(some[:, 0]) for some in (tracks, given))
    state = coder.room_for(min(sides[0] * sides[1], points_kernels.MAX_CELLS) + 2 * len(first) + 3)
    if not points_kernels.code_first(state, first, taken, sides, np.array(_POINTS_BEFORE)):
        raise BitstreamError("a frame has no room for its points")
    coder.check()
    tracks[:, 0] = first
    reach = max(sides[0] * sides[1] / _AREA_OF_REACH, 1.0)
    order, units, motion = _kernels.begin_motion(given, tracks, reach, _LEVEL)
    pixel = float(2**config.tracks.subpixel_bits)
    t = 1
    while t < units.shape[1]:
        state = coder.room_for(len(units) * points_kernels.MAX_SYMBOLS)
        t = _kernels.code_instants(state, models, motion, units, t, len(given), np.array(sides), pixel)
        coder.check()
        if t == _kernels.OUTSIDE:
            raise BitstreamError("a track leaves the frame")
    coded: Integers = np.empty_like(units[len(given) :])
    coded[order] = units[len(given) :]
    return coded
