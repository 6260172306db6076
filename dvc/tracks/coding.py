"""Payloads of point tracks and of feature points.

Tracks are coded by regression (`dvc.tracks.regression`): first those that were not followed back in time,
then those that were, back in time, with the first ones as neighbours.

Points are coded frame by frame: columns as the steps from each point to the next (differential pulse code
modulation), one decision per step; its probability follows from the remaining points and columns. A row is a
number of fixed length among the free rows: points keep a distance, which is sent once.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Floats, Integers
from dvc.config import CodecConfig
from dvc.entropy import RangeCoder
from dvc.errors import BitstreamError
from dvc.tracks import _kernels
from dvc.tracks._kernels import LOST
from dvc.tracks.points import FeaturePoints, PointTracks, num_positions
from dvc.tracks.regression.regression_coding import code_tracks


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
        The payload; empty without tracks.

    Raises
    ------
    ValueError
        If the tracks are too many, or one has no position in its key frame, comes back or leaves the frame.
    """
    if len(tracks) == 0:
        return b""
    units = _units(tracks.positions, config)
    num_forward = len(tracks) - tracks.num_backward
    forward = _scanned(units[:num_forward], "first", config)
    backward = _scanned(units[num_forward:, ::-1], "last", config)
    coder = RangeCoder.writer()
    code_tracks(coder, forward, backward, config)
    return coder.to_bytes(shortest=True)


def _scanned(units: Integers, key: str, config: CodecConfig) -> Integers:
    """Return tracks in their direction of time in column scan of their starts."""
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
        Those that start in the first key frame, in column scan of their positions there, then the rest in
        column scan of those in the last.

    Raises
    ------
    BitstreamError
        If the payload is damaged.
    """
    if not payload:
        return PointTracks.none(num_instants)
    most = np.full((config.tracks.num_points, num_instants, 2), LOST, np.int64)
    forward, backward = code_tracks(RangeCoder.reader(payload), most, most, config)
    units = np.concatenate([forward, backward[:, ::-1]])
    scale = 2.0**config.tracks.subpixel_bits
    tracks = PointTracks(np.where(units == LOST, np.nan, units / scale), len(backward))
    if encode_tracks(tracks, config) != payload:
        raise BitstreamError("the tracks are followed by other data, or are damaged")
    return tracks


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
        If the points are too many, or one is outside the frame.
    """
    max_points = config.tracks.num_points
    sets = [_units(frame, config) for frame in points.frames]
    if max(map(len, sets), default=0) == 0:
        return b""
    if max(map(len, sets)) > max_points or any(np.any(units == LOST) for units in sets):
        raise ValueError(f"`points` must be known and at most {max_points} a frame")
    sets = [units[column_scan(units)] for units in sets]
    coder = RangeCoder.writer()
    exponent = min(int(_kernels.grid_exponent(units)) for units in sets)
    limit = _kernels.DISTANCES - 1
    distance = min(int(_kernels.min_distance(units >> exponent, limit)) for units in sets)
    _code_sets(coder, sets, exponent, distance, config)
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
    most = np.zeros((config.tracks.num_points, 2), np.int64)
    sets = _code_sets(RangeCoder.reader(payload), [most] * num_frames, 0, 0, config)
    points = FeaturePoints(tuple(units / 2.0**config.tracks.subpixel_bits for units in sets))
    if encode_points(points, config) != payload:
        raise BitstreamError("the points are followed by other data, or are damaged")
    return points


def _code_sets(
    coder: RangeCoder, sets: Sequence[Integers], exponent: int, distance: int, config: CodecConfig
) -> list[Integers]:
    """Code the points of frames, after the exponent of their grid and their least distance on it."""
    exponent, distance = map(int, _kernels.code_grid(coder.room_for(2), exponent, distance))
    coder.check()
    columns, rows = ((side - 1 >> exponent) + 1 for side in num_positions(config))
    coded = []
    for units in sets:
        count = coder.uniform(config.tracks.num_points + 1, len(units))
        points = units[:count] >> exponent
        if not _kernels.code_points(coder.room_for(columns + 2 * count), points, columns, rows, distance):
            raise BitstreamError("a frame has no room for its points")
        coder.check()
        coded.append(points << exponent)
    return coded


def column_scan(points: Floats | Integers) -> NDArray[np.intp]:
    """Return the order of points column by column, from the top in each."""
    return np.lexsort((points[:, 1], points[:, 0]))


def _units(positions: Floats, config: CodecConfig) -> Integers:
    """Return positions in units of the last binary digit; `LOST` if they are unknown."""
    units = np.empty(positions.shape, np.int64)
    scale = 2.0**config.tracks.subpixel_bits
    points = np.ascontiguousarray(positions, np.float64).reshape(-1, 2)
    if not _kernels.set_units(points, scale, np.array(num_positions(config)), units.reshape(-1, 2)):
        raise ValueError("points must be inside the frame")
    return units
