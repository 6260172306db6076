"""Payloads of point tracks and of feature points: differential, with adaptive arithmetic coding.

The first positions of the tracks are coded as a point set; then, instant by instant, whether a track is
lost and how far it is from where its past and its neighbours let it be expected. Tracks that were followed
back in time come after those that were not, and are coded back in time, with these as neighbours.
"""

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig
from dvc.entropy import RangeCoder, context_counts
from dvc.errors import BitstreamError
from dvc.tracks import _kernels
from dvc.tracks._kernels import LOST
from dvc.tracks.point_sets import SamplingGrid, code_points, column_scan
from dvc.tracks.points import FeaturePoints, PointTracks
from dvc.tracks.regression import code_tracks

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Probability of a 1 before anything has been seen, in percent, for each class of residuals: what real and
# rendered clips have on the mean, at whole, half and quarter pixels, over groups of 2, 5 and 10 frames.
_PERCENT = {
    _kernels.ZERO: (7, 24, 41, 60, 73, 85, 90, 95, 97, 97),
    _kernels.ZERO_FAR: (37, 38, 46, 60, 71, 85, 91, 96, 97, 97),
    1: (4, 3, 3, 4, 15, 42, 64, 79, 85, 91),
    2: (21, 20, 12, 10, 10, 16, 34, 56, 71, 81),
    3: (25, 25, 25, 25, 24, 25, 17, 24, 47, 70),
    4: (25, 25, 25, 25, 20, 24, 25, 26, 25, 46),
    _kernels.MANTISSA + 1: (5, 5, 7, 15, 31, 43, 50, 48, 45, 50),
    _kernels.MANTISSA + 2: (25, 20, 15, 12, 14, 25, 39, 47, 55, 60),
    _kernels.SIGN: (25, 20, 20, 29, 42, 45, 45, 45, 45, 50),
    _kernels.SIGN + 1: (50,) * _kernels.NUM_CLASSES,
    _kernels.SIGN + 2: (75, 80, 80, 75, 65, 55, 50, 45, 45, 50),
}
_PERCENT_OF_THE_REST = 30
_PERCENT_LOST = 4
_PERCENT_LOST_BACKWARD = 12


def encode_tracks(tracks: PointTracks, config: CodecConfig) -> bytes:
    """Write point tracks; inverse of `decode_tracks`.

    Parameters
    ----------
    tracks : PointTracks
        At most ``config.tracks.num_points`` that start in the first key frame, and as many that were
        followed back from the last; both in any order. Positions lie in the frame and are rounded to
        ``config.tracks.subpixel_bits`` binary digits; a track that is lost stays lost.
    config : CodecConfig
        Configuration of the stream.

    Returns
    -------
    bytes
        The payload; empty if there are no tracks.

    Raises
    ------
    ValueError
        If there are too many tracks, or one is not known in its key frame, comes back or leaves the frame.
    """
    if len(tracks) == 0:
        return b""
    units = _units(tracks.positions, config)
    num_forward = len(tracks) - tracks.num_backward
    forward = _scanned(units[:num_forward], "first", config)
    backward = _scanned(units[num_forward:, ::-1], "last", config)
    return _written(forward, backward, config)


def _written(forward: Integers, backward: Integers, config: CodecConfig) -> bytes:
    coder = RangeCoder.writer()
    _code_tracks(coder, forward, backward, config)
    return coder.to_bytes(shortest=config.tracks.coding == "regression")


def _scanned(units: Integers, key: str, config: CodecConfig) -> Integers:
    """Return tracks in their direction of time in column scan of where they start."""
    if len(units) > config.tracks.num_points:
        raise ValueError(f"`tracks` must be at most {config.tracks.num_points}, got {len(units)}")
    if (units[:, 0, 0] == LOST).any():
        raise ValueError(f"`tracks` must be known in the {key} key frame")
    units = units[column_scan(units[:, 0])]
    if not _kernels.is_lost_for_good(units):
        raise ValueError("`tracks` must not come back once they are lost")
    return units


def decode_tracks(payload: bytes, num_instants: int, config: CodecConfig) -> PointTracks:
    """Read point tracks; inverse of `encode_tracks`.

    Parameters
    ----------
    payload : bytes
        As `encode_tracks` returns it.
    num_instants : int
        Frames from the first key frame to the last, both included; at least 2.
    config : CodecConfig
        Configuration of the stream.

    Returns
    -------
    PointTracks
        Those that start in the first key frame in column scan of their positions there, then the others in
        column scan of those in the last.

    Raises
    ------
    BitstreamError
        If the payload is damaged.
    """
    if not payload:
        return PointTracks.none(num_instants)
    most = np.full((config.tracks.num_points, num_instants, 2), LOST, np.int64)
    forward, backward = _code_tracks(RangeCoder.reader(payload), most, most, config)
    if len(forward) + len(backward) == 0 or _written(forward, backward, config) != payload:
        raise BitstreamError("the tracks are followed by other data, or are damaged")
    units = np.concatenate([forward, backward[:, ::-1]])
    scale = 2.0**config.tracks.subpixel_bits
    return PointTracks(np.where(units == LOST, np.nan, units / scale), len(backward))


def _code_tracks(
    coder: RangeCoder, forward: Integers, backward: Integers, config: CodecConfig
) -> tuple[Integers, Integers]:
    """Code tracks, each in its own direction of time; when reading, as many as there can be are given."""
    if config.tracks.coding == "regression":
        return code_tracks(coder, forward, backward, config)
    bound = config.tracks.num_points + 1
    num_forward, num_backward = (coder.uniform(bound, len(units)) for units in (forward, backward))
    counts = _initial_counts()
    forward = _code_direction(coder, forward[:num_forward], 0, counts, config)
    given = forward[forward[:, -1, 0] != LOST, ::-1]  # those that reach the last key frame, back in time
    counts[_kernels.LOSS] = context_counts(_PERCENT_LOST_BACKWARD)
    units = np.concatenate([given, backward[:num_backward]])
    return forward, _code_direction(coder, units, len(given), counts, config)


def _code_direction(
    coder: RangeCoder, units: Integers, num_given: int, counts: Integers, config: CodecConfig
) -> Integers:
    """Code all tracks but the first ones, which are given, and return those that were coded."""
    if len(units) == num_given:
        return units[num_given:]
    units = units.copy()
    first, sides = units[:, 0], _sides(config)
    grid = SamplingGrid.of([first[num_given:]], *sides).code(coder)
    first[num_given:] = code_points(coder, first[num_given:], grid)
    motion, weights = _start(first, config)
    for t in range(1, units.shape[1]):
        live = units[:, t - 1, 0] != LOST
        position = np.ascontiguousarray(units[:, t])
        state = coder.room_for(len(units) * _kernels.MAX_SYMBOLS)
        inside = _kernels.code_instant(
            state, position, live, num_given, motion, weights, np.array(sides), t > 1, counts
        )
        coder.check()
        if not inside:
            raise BitstreamError("a track leaves the frame")
        units[:, t] = position
    return units[num_given:]


def _start(first: Integers, config: CodecConfig) -> tuple[Integers, Integers]:
    motion = np.zeros((len(first), 3, 2), np.int64)
    motion[:, 0] = first * 256
    width, height = _sides(config)
    return motion, _kernels.neighbour_weights(first, max(width * height // 84, 1))


def _initial_counts() -> Integers:
    """Return counts from which the contexts start, as if each had seen a few decisions."""
    percent = np.full((2, _kernels.NUM_CLASSES, _kernels.CONTEXTS_PER_CLASS), _PERCENT_OF_THE_REST)
    for offset, of_class in _PERCENT.items():
        percent[:, :, offset] = of_class
    return context_counts(np.concatenate([[_PERCENT_LOST], percent.ravel()]))


def encode_points(points: FeaturePoints, config: CodecConfig) -> bytes:
    """Write the feature points of frames; inverse of `decode_points`.

    Parameters
    ----------
    points : FeaturePoints
        At most ``config.tracks.num_points`` a frame, in any order, rounded to
        ``config.tracks.subpixel_bits`` binary digits.
    config : CodecConfig
        Configuration of the stream.

    Returns
    -------
    bytes
        The payload; empty if no frame has any.

    Raises
    ------
    ValueError
        If there are too many points, or one is outside the frame.
    """
    max_points = config.tracks.num_points
    sets = [_units(frame, config) for frame in points.frames]
    if max(map(len, sets), default=0) == 0:
        return b""
    if max(map(len, sets)) > max_points or any(np.any(units == LOST) for units in sets):
        raise ValueError(f"`points` must be known and at most {max_points} a frame")
    sets = [units[column_scan(units)] for units in sets]
    coder = RangeCoder.writer()
    grid = SamplingGrid.of(sets, *_sides(config)).code(coder)
    for units in sets:
        coder.uniform(max_points + 1, len(units))
        code_points(coder, units, grid)
    return coder.to_bytes()


def decode_points(payload: bytes, num_frames: int, config: CodecConfig) -> FeaturePoints:
    """Read the feature points of frames; inverse of `encode_points`.

    Parameters
    ----------
    payload : bytes
        As `encode_points` returns it.
    num_frames : int
        Wyner-Ziv frames that it covers.
    config : CodecConfig
        Configuration of the stream.

    Returns
    -------
    FeaturePoints
        Each frame in column scan.

    Raises
    ------
    BitstreamError
        If the payload is damaged.
    """
    if not payload:
        return FeaturePoints(tuple(np.empty((0, 2)) for _ in range(num_frames)))
    coder = RangeCoder.reader(payload)
    grid = SamplingGrid.of([], *_sides(config)).code(coder)
    scale = 2.0**config.tracks.subpixel_bits
    frames = []
    for _ in range(num_frames):
        count = coder.uniform(config.tracks.num_points + 1)
        frames.append(code_points(coder, np.zeros((count, 2), np.int64), grid) / scale)
    points = FeaturePoints(tuple(frames))
    if encode_points(points, config) != payload:
        raise BitstreamError("the points are followed by other data, or are damaged")
    return points


def _sides(config: CodecConfig) -> tuple[int, int]:
    """Return the places for a point in x and y."""
    bits = config.tracks.subpixel_bits
    return (config.video.width - 1 << bits) + 1, (config.video.height - 1 << bits) + 1


def _units(positions: Floats, config: CodecConfig) -> Integers:
    """Return positions in units of the last binary digit; `LOST` where they are not known."""
    units = np.empty(positions.shape, np.int64)
    scale = 2.0**config.tracks.subpixel_bits
    points = np.ascontiguousarray(positions, np.float64).reshape(-1, 2)
    if not _kernels.set_units(points, scale, np.array(_sides(config)), units.reshape(-1, 2)):
        raise ValueError("points must be inside the frame")
    return units
