"""Frames, their times, and properties of a video."""

from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from dvc.errors import VideoError
from dvc.limits import MAX_SIDE_PX, MAX_TICKS_PER_SECOND

Plane = NDArray[np.uint8]

NEUTRAL_CHROMA = 128
MAX_PIXELS = 2**26
MIN_FRAME_RATE, MAX_FRAME_RATE = 1e-6, 1e6


def chroma_shape(height: int, width: int) -> tuple[int, int]:
    """Return the shape of a 4:2:0 chroma plane; odd luma sides round up.

    Parameters
    ----------
    height, width : int
        Sides of the luma plane in pixels.

    Returns
    -------
    tuple of int
        Rows and columns of each chroma plane.
    """
    return (height + 1) // 2, (width + 1) // 2


class TimeStamp(NamedTuple):
    """Display time of a frame by the clock of its source, which may begin with any number."""

    ticks: int
    ticks_per_second: int  # at most `MAX_TICKS_PER_SECOND`

    @classmethod
    def nearest(cls, time_s: Fraction, ticks_per_second: int) -> Self:
        """Return a time in ticks of a clock, or in microseconds if the ticks are finer."""
        ticks_per_second = min(ticks_per_second, MAX_TICKS_PER_SECOND)
        return cls(round(time_s * ticks_per_second), ticks_per_second)

    @property
    def seconds(self) -> Fraction:
        """The same in seconds."""
        return Fraction(self.ticks, self.ticks_per_second)


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """One 8-bit picture: luma, and chroma at half the resolution in both directions unless it is grey.

    Samples are those of the file. YCbCr sources keep their range, which is the ITU limited range (16 to 235)
    in nearly every file; RGB sources are converted to BT.601 limited range when they are read.

    Attributes
    ----------
    luma : ndarray of shape (H, W), uint8
        Y samples.
    chroma : tuple of two ndarrays of shape ((H + 1) // 2, (W + 1) // 2), uint8, or None
        Cb and Cr samples; None for a grey picture.
    time : TimeStamp or None
        Display time; None: a frame interval after the previous frame.

    Raises
    ------
    ValueError
        If a plane has another type or shape.
    """

    luma: Plane
    chroma: tuple[Plane, Plane] | None = None
    time: TimeStamp | None = None

    def __post_init__(self) -> None:
        if self.luma.dtype != np.uint8 or self.luma.ndim != 2 or self.luma.size == 0:
            raise ValueError(
                f"`luma` must be a non-empty 2-D uint8 array, got {self.luma.dtype} {self.luma.shape}"
            )
        shape = chroma_shape(*self.luma.shape)
        for plane in self.chroma or ():
            if plane.dtype != np.uint8 or plane.shape != shape:
                raise ValueError(
                    f"`chroma` must be two uint8 planes of {shape}, got {plane.dtype} {plane.shape}"
                )

    @property
    def height(self) -> int:
        """Rows of the luma plane."""
        return int(self.luma.shape[0])

    @property
    def width(self) -> int:
        """Columns of the luma plane."""
        return int(self.luma.shape[1])

    def without_chroma(self) -> "Frame":
        """Return the grey picture with the same luma plane."""
        return Frame(self.luma)

    def with_chroma(self) -> "Frame":
        """Return the picture itself if it has chroma, otherwise the same luma plane with neutral chroma."""
        if self.chroma is not None:
            return self
        shape = chroma_shape(self.height, self.width)
        cb, cr = np.full((2, *shape), NEUTRAL_CHROMA, np.uint8)
        return Frame(self.luma, (cb, cr))


def check_size(width: int, height: int, what: str) -> None:
    """Refuse picture sizes beyond the limits."""
    if min(width, height) < 1 or max(width, height) > MAX_SIDE_PX or width * height > MAX_PIXELS:
        raise VideoError(
            f"{what}: {width}x{height} pictures are not supported "
            f"(sides 1 to {MAX_SIDE_PX}, at most {MAX_PIXELS} pixels)"
        )


def check_frame_rate(frame_rate: Fraction | float, what: str) -> None:
    """Refuse unsupported frame rates."""
    if not MIN_FRAME_RATE <= frame_rate <= MAX_FRAME_RATE:
        raise VideoError(
            f"{what}: {float(frame_rate):g} frames per second are not supported (10**-6 to 10**6)"
        )


def exact_frame_rate(frame_rate: Fraction | float) -> Fraction:
    """Return the rate as a fraction; 29.97 and similar rates become the NTSC rates that they denote.

    Parameters
    ----------
    frame_rate : Fraction or float
        Frames per second.

    Returns
    -------
    Fraction
        Numerator and denominator below 2**31.

    Raises
    ------
    ValueError
        If the rate is not between 10**-6 and 10**6.

    Examples
    --------
    >>> exact_frame_rate(29.97), exact_frame_rate(12.5)
    (Fraction(30000, 1001), Fraction(25, 2))
    """
    if not MIN_FRAME_RATE <= frame_rate <= MAX_FRAME_RATE:
        raise ValueError(f"`frame_rate` must be positive and at most 10**6, got {frame_rate}")
    if isinstance(frame_rate, float):
        ntsc = Fraction(round(frame_rate) * 1000, 1001)
        if frame_rate != round(frame_rate) and abs(frame_rate - ntsc) < 0.005:
            return ntsc
    limit = 10**6 if frame_rate < 2000 else 1000
    return Fraction(frame_rate).limit_denominator(limit)


@dataclass(frozen=True)
class VideoInfo:
    """Properties of a video that are known before its frames are read.

    Attributes
    ----------
    width, height : int
        Sides in pixels.
    frame_rate : Fraction
        Frames per second.
    num_frames : int or None
        Declared number of frames, if the file declares it; the number of frames that are read counts.
    notices : tuple of str
        Conversions, assumptions and omissions on the way to 8-bit 4:2:0 frames.
    full_range : bool
        True if the samples use 0 to 255 and not the ITU limited range; they are kept as they are.
    live : bool
        True if frames arrive in real time: from a pipe, a device or a network.
    """

    width: int
    height: int
    frame_rate: Fraction
    num_frames: int | None = None
    notices: tuple[str, ...] = ()
    full_range: bool = False
    live: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels, in the order of command lines."""
        return self.width, self.height
