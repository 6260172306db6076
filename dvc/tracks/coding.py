"""Payloads of point tracks and of feature points: differential, with adaptive arithmetic coding.

The first positions of the tracks are coded as a point set; then, instant by instant, whether a track is
lost and how far it is from where its past and its neighbours let it be expected. Tracks that were followed
back in time come after those that were not, and are coded back in time, with these as neighbours.
"""

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.tracks import _kernels
from dvc.tracks._kernels import LOST
from dvc.tracks.point_sets import Lattice, column_scan, read_points, write_points
from dvc.tracks.points import FeaturePoints, PointTracks
from dvc.tracks.range_coding import RangeReader, RangeWriter

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_MAX_EXPONENT = 24

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
_INITIAL_COUNT = 320  # twenty decisions


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
    return _write_tracks(
        _scanned(tracks.forward, "first", config), _scanned(tracks.backward[:, ::-1], "last", config), config
    )


def _scanned(positions: Floats, key: str, config: CodecConfig) -> Integers:
    """Return tracks in their direction of time in units, in column scan of where they start."""
    if len(positions) > config.tracks.num_points:
        raise ValueError(f"`tracks` must be at most {config.tracks.num_points}, got {len(positions)}")
    units = _units(positions, config)
    known = units[:, :, 0] != LOST
    if not known[:, 0].all():
        raise ValueError(f"`tracks` must be known in the {key} key frame")
    if (known[:, 1:] & ~known[:, :-1]).any():
        raise ValueError("`tracks` must not come back once they are lost")
    return units[column_scan(units[:, 0])]


def _write_tracks(forward: Integers, backward: Integers, config: CodecConfig) -> bytes:
    """Write tracks, each in its own direction of time."""
    writer = RangeWriter()
    for units in (forward, backward):
        _write_count(writer, len(units), config.tracks.num_points + 1)
    counts = _initial_counts()
    _write_direction(writer, forward, 0, counts, config)
    given = _reversed(forward)
    counts[_kernels.LOSS] = _count_of(_PERCENT_LOST_BACKWARD)
    _write_direction(writer, np.concatenate([given, backward]), len(given), counts, config)
    return writer.to_bytes()


def _write_direction(
    writer: RangeWriter, units: Integers, num_given: int, counts: Integers, config: CodecConfig
) -> None:
    if len(units) == num_given:
        return
    first = np.ascontiguousarray(units[:, 0])
    sides = _sides(config)
    lattice = Lattice.of([first[num_given:]], *sides)
    lattice.write(writer)
    write_points(writer, first[num_given:], lattice)
    motion, weights = _start(first, config)
    for t in range(1, units.shape[1]):
        live = units[:, t - 1, 0] != LOST
        position = np.ascontiguousarray(units[:, t])
        writer.write_decisions(
            *_kernels.instant_decisions(
                position, live, num_given, motion, weights, np.array(sides), t > 1, counts
            )
        )


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
    reader = RangeReader(payload)
    num_forward, num_backward = (reader.read_uniform(config.tracks.num_points + 1) for _ in range(2))
    none = np.empty((0, num_instants, 2), np.int64)
    counts = _initial_counts()
    forward = _read_direction(reader, num_forward, none, counts, config)
    counts[_kernels.LOSS] = _count_of(_PERCENT_LOST_BACKWARD)
    backward = _read_direction(reader, num_backward, _reversed(forward), counts, config)
    if num_forward + num_backward == 0 or _write_tracks(forward, backward, config) != payload:
        raise BitstreamError("the tracks are followed by other data, or are damaged")
    units = np.concatenate([forward, backward[:, ::-1]])
    scale = 2.0**config.tracks.subpixel_bits
    return PointTracks(np.where(units == LOST, np.nan, units / scale), num_backward)


def _read_direction(
    reader: RangeReader, count: int, given: Integers, counts: Integers, config: CodecConfig
) -> Integers:
    num_given, num_instants, _ = given.shape
    units = np.full((num_given + count, num_instants, 2), LOST, np.int64)
    if count == 0:
        return units[:0]
    units[:num_given] = given
    units[num_given:, 0] = read_points(reader, count, Lattice.read(reader, *_sides(config)))
    motion, weights = _start(units[:, 0], config)
    sides = np.array(_sides(config))
    for t in range(1, num_instants):
        live = np.flatnonzero(units[:, t - 1, 0] != LOST)
        position = np.ascontiguousarray(units[:, t])
        _read_instant(reader, position, live, num_given, motion, weights, sides, t > 1, counts)
        units[:, t] = position
        if (units[live, t] < LOST).any() or (units[live, t] >= sides).any():
            raise BitstreamError("a track leaves the frame")
    return units[num_given:]


def _reversed(forward: Integers) -> Integers:
    """Return the tracks that reach the last key frame, back in time."""
    return forward[forward[:, -1, 0] != LOST, ::-1]


def _write_count(writer: RangeWriter, count: int, bound: int) -> None:
    writer.write_uniform(np.array([count], np.int32), np.array([bound], np.int32))


def _start(first: Integers, config: CodecConfig) -> tuple[Integers, Integers]:
    motion = np.zeros((len(first), 3, 2), np.int64)
    motion[:, 0] = first * 256
    width, height = _sides(config)
    return motion, _kernels.neighbour_weights(first, max(width * height // 84, 1))


def _read_instant(
    reader: RangeReader,
    position: Integers,
    live: NDArray[np.intp],
    num_given: int,
    motion: Integers,
    weights: Integers,
    sides: Integers,
    started: bool,
    counts: Integers,
) -> None:
    """Read where the live tracks are into `position`, which holds the given ones."""
    predictions = np.zeros((len(motion), 2, 3), np.int64)
    for i in live:
        prediction = predictions[i]
        if i >= num_given and _read_adaptive(reader, counts, _kernels.LOSS):
            continue
        _kernels.predict(position, motion, i, weights, sides, started, prediction)
        if i >= num_given:
            _read_position(reader, position[i], prediction, counts)
        _kernels.follow(position, motion, i, prediction)
    _kernels.advance(position, motion, predictions, sides, started)


def _read_position(reader: RangeReader, position: Integers, prediction: Integers, counts: Integers) -> None:
    for axis in range(2):
        base = _kernels.first_context(axis, prediction)
        predicted = int(prediction[axis, 0])
        position[axis] = (predicted + 128 >> 8) + _read_residual(reader, counts, base, predicted)
    if (position <= LOST).any():
        raise BitstreamError("a track leaves the frame")


def _read_residual(reader: RangeReader, counts: Integers, base: int, predicted: int) -> int:
    if not _read_adaptive(reader, counts, _kernels.zero_context(base, predicted)):
        return 0
    positive = _read_adaptive(reader, counts, _kernels.sign_context(base, predicted))
    exponent = 1
    while _read_adaptive(reader, counts, _kernels.exponent_context(base, exponent)):
        exponent += 1
        if exponent > _MAX_EXPONENT:
            raise BitstreamError("a track leaves the frame")
    magnitude = 2 | _read_adaptive(reader, counts, _kernels.mantissa_context(base, exponent))
    for _ in range(exponent - 1):
        magnitude = magnitude << 1 | reader.read_decision(0.5)
    return magnitude - 1 if positive else 1 - magnitude


def _read_adaptive(reader: RangeReader, counts: Integers, context: int) -> int:
    decision = reader.read_decision(_kernels.probability(counts, context))
    _kernels.adapt(counts, context, decision)
    return decision


def _initial_counts() -> Integers:
    """Return counts from which the contexts start, as if each had seen a few decisions."""
    percent = np.full((2, _kernels.NUM_CLASSES, _kernels.CONTEXTS_PER_CLASS), _PERCENT_OF_THE_REST)
    for offset, of_class in _PERCENT.items():
        percent[:, :, offset] = of_class
    return _count_of(np.concatenate([[_PERCENT_LOST], percent.ravel()]))


def _count_of(percent: Integers | int) -> Integers:
    ones = np.asarray(percent) * _INITIAL_COUNT // 100
    return np.stack([_INITIAL_COUNT - ones, ones], axis=-1)


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
    most = config.tracks.num_points
    sets = [_units(frame, config) for frame in points.frames]
    if max(map(len, sets), default=0) == 0:
        return b""
    if max(map(len, sets)) > most or any(np.any(units == LOST) for units in sets):
        raise ValueError(f"`points` must be known and at most {most} a frame")
    sets = [np.ascontiguousarray(units[column_scan(units)]) for units in sets]
    writer = RangeWriter()
    lattice = Lattice.of(sets, *_sides(config))
    lattice.write(writer)
    for units in sets:
        _write_count(writer, len(units), most + 1)
        write_points(writer, units, lattice)
    return writer.to_bytes()


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
    reader = RangeReader(payload)
    lattice = Lattice.read(reader, *_sides(config))
    scale = 2.0**config.tracks.subpixel_bits
    frames = []
    for _ in range(num_frames):
        count = reader.read_uniform(config.tracks.num_points + 1)
        frames.append(read_points(reader, count, lattice) / scale)
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
    lost = np.logical_not(np.isfinite(positions).all(axis=-1))
    scaled = np.where(lost[..., None], 0.0, positions) * 2.0**config.tracks.subpixel_bits
    rounded = np.rint(np.clip(scaled, -1.0, 2.0**20)).astype(np.int64)
    if (rounded < 0).any() or (rounded >= _sides(config)).any():
        raise ValueError("points must be inside the frame")
    rounded[lost] = LOST
    return rounded
