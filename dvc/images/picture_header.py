"""What a decoder of a picture needs beside its size and its code: three bytes."""

from dataclasses import dataclass
from typing import Self

from dvc.errors import BitstreamError
from dvc.images.zerotree_coder import MAX_PLANES

MAX_LEVELS = 15


@dataclass(frozen=True)
class PictureHeader:
    """What a decoder needs beside size and data."""

    num_levels: int  # how many times planes are split, at most `MAX_LEVELS`
    num_bit_planes: int  # bit planes of the coefficients, at most `MAX_PLANES`
    colour: bool = False  # three planes instead of one
    wavelet: str = "9/7"  # ``9/7`` or ``5/3``
    adaptive: bool = True  # arithmetic coding; else plain bits
    # where coefficients lie in their intervals, at first and once refined: k for (k + 2) / 32; below 16
    points: tuple[int, int] = (10, 12)

    SIZE = 3
    """Bytes."""

    def to_bytes(self) -> bytes:
        """Return the header as bytes; the inverse of `from_bytes`."""
        flags = self.colour | (self.wavelet == "5/3") << 1 | self.adaptive << 2
        return bytes(
            [self.num_levels | flags << 4, self.num_bit_planes, self.points[0] << 4 | self.points[1]]
        )

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Read a header."""
        if len(data) < cls.SIZE:
            raise BitstreamError("the header of the reference view is cut off")
        first, num_bit_planes, points = data[: cls.SIZE]
        flags = first >> 4
        if flags > 7 or num_bit_planes > MAX_PLANES:
            raise BitstreamError("the header of the reference view is damaged")
        wavelet = "5/3" if flags & 2 else "9/7"
        return cls(
            first & 15, num_bit_planes, bool(flags & 1), wavelet, bool(flags & 4), (points >> 4, points & 15)
        )
