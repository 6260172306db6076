"""Time stamps of frames: how much later than at the constant frame rate each is shown."""

from fractions import Fraction
from itertools import accumulate, pairwise
from typing import NamedTuple

from dvc.bits import decode_varint, encode_varint
from dvc.config import VideoConfig
from dvc.errors import BitstreamError
from dvc.limits import MAX_TICKS_PER_SECOND

MAX_DEVIATION_TICKS = 2**33 - 1


class Deviations(NamedTuple):
    """Deviations from the constant frame rate of the frames of a group of pictures, not all of them 0."""

    ticks_per_second: int
    ticks: tuple[int, ...]  # deviation of each frame, in display order

    def of_last(self) -> "Deviations | None":
        """Return the deviation of the last frame, if it has one."""
        return Deviations(self.ticks_per_second, self.ticks[-1:]) if self.ticks[-1] else None


def encode_deviations(deviations: Deviations) -> bytes:
    """Write the ticks of a second, the first deviation, and differences; inverse of `decode_deviations`."""
    differences = (after - before for before, after in pairwise((0, *deviations.ticks)))
    numbers = (2 * value if value >= 0 else -2 * value - 1 for value in differences)
    return b"".join(map(encode_varint, (deviations.ticks_per_second, *numbers)))


def decode_deviations(payload: bytes, position: int, num_frames: int) -> tuple[Deviations, int]:
    """Read the deviations of a number of frames; inverse of `encode_deviations`."""
    ticks_per_second, position = decode_varint(payload, position)
    if not 1 <= ticks_per_second <= MAX_TICKS_PER_SECOND:
        raise BitstreamError(f"{ticks_per_second} ticks a second, 1 to {MAX_TICKS_PER_SECOND} are allowed")
    differences = []
    for _ in range(num_frames):
        number, position = decode_varint(payload, position)
        differences.append(-(number + 1 >> 1) if number & 1 else number >> 1)
    ticks = tuple(accumulate(differences))
    if not any(ticks):
        raise BitstreamError("time stamps are announced, but are those of the constant frame rate")
    _check_range(ticks)
    return Deviations(ticks_per_second, ticks), position


def _check_range(ticks: tuple[int, ...]) -> None:
    if max(map(abs, ticks)) > MAX_DEVIATION_TICKS:
        raise BitstreamError(f"a time stamp is more than {MAX_DEVIATION_TICKS} ticks off")


def frame_times_s(
    video: VideoConfig, first_index: int, num_frames: int, deviations: Deviations | None
) -> list[Fraction]:
    """Return when frames are shown, in seconds."""
    interval_s = Fraction(video.frame_rate_den, video.frame_rate_num)
    indices = range(first_index, first_index + num_frames)
    if deviations is None:
        return [index * interval_s for index in indices]
    ticks_per_second, ticks = deviations
    return [
        Fraction(planned_tick(index, interval_s * ticks_per_second) + late, ticks_per_second)
        for index, late in zip(indices, ticks, strict=True)
    ]


def planned_tick(index: int, ticks_per_frame: Fraction) -> int:
    """Return the tick closest to a frame at the constant frame rate, from which deviations are counted."""
    ticks, num_frames = ticks_per_frame.as_integer_ratio()
    return (2 * index * ticks + num_frames) // (2 * num_frames)


def check_times(times_s: list[Fraction], before_s: Fraction | None) -> None:
    """Refuse frames that are not shown one after the other."""
    times_s = times_s if before_s is None else [before_s, *times_s]
    if any(after <= before for before, after in pairwise(times_s)):
        raise BitstreamError("a time stamp is not after that of the frame before")


def following(before: Deviations | None, deviations: Deviations | None, num_frames: int) -> Deviations | None:
    """Return the deviations of frames of a segment after those of the segment before."""
    if before is None:
        return deviations
    ticks_per_second, ticks = deviations or Deviations(before.ticks_per_second, (0,) * num_frames)
    delay = round(Fraction(before.ticks[-1] * ticks_per_second, before.ticks_per_second))
    ticks = tuple(min(max(value + delay, -MAX_DEVIATION_TICKS), MAX_DEVIATION_TICKS) for value in ticks)
    return Deviations(ticks_per_second, ticks) if any(ticks) else None
