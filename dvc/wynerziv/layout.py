"""Where things are in a Wyner-Ziv frame: bands, bit planes, and the header that tells their quantisers.

Planes are numbered over the whole frame in decoding order: bands in zigzag order, each from its most
significant plane down. A frame's payload starts with its header.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from dvc.bits import BitReader, pack_digits
from dvc.config import MAX_BAND_PLANES, CodecConfig
from dvc.errors import BitstreamError
from dvc.slepian_wolf import CRC_BITS
from dvc.wynerziv import quantizer, transform

_PLANE_COUNT_BITS = 4


@dataclass(frozen=True)
class Quantization:
    """Quantisers of one frame's bands, which its header tells."""

    embedded: (
        bool  # whether bins are embedded; else their number is given and they share the range of the band
    )
    planes: tuple[int, ...]  # bit planes of the 16 bands, in zigzag order; 0 for one that is not sent
    # index for `quantizer.step_from_index` by band; DC has none where its range is given
    step_indices: dict[int, int]
    header: bytes  # all of this, as a frame's payload starts with it

    @cached_property
    def bands(self) -> tuple[int, ...]:
        """Bands that are sent, in decoding order."""
        return tuple(band for band, planes in enumerate(self.planes) if planes)

    @cached_property
    def first_plane(self) -> tuple[int, ...]:
        """Frame-wide number of each band's most significant plane, or of the next one where it has none."""
        return (0, *accumulate(self.planes[:-1]))

    @cached_property
    def num_planes(self) -> int:
        """Planes in the frame."""
        return sum(self.planes)

    @property
    def num_words(self) -> int:
        """Words of 64 bits that hold one bit of each plane."""
        return -(-self.num_planes // 64)

    def step(self, band: int) -> float | None:
        """Return the width of a band's bins."""
        index = self.step_indices.get(band)
        return None if index is None else quantizer.step_from_index(index)

    def edges(self, band: int) -> NDArray[np.float64]:
        """Return the borders of a band's bins."""
        step = self.step(band)
        if self.embedded:
            assert step is not None
            return quantizer.embedded_edges(band, self.planes[band], step)
        return quantizer.bin_edges(1 << self.planes[band], step)


@dataclass(frozen=True)
class FrameLayout:
    """Where things are in the Wyner-Ziv frames of one configuration."""

    height: int  # sides of the luma plane in pixels
    width: int
    embedded: bool  # whether bins are embedded, so that frames differ in their planes
    # most bit planes of the 16 bands, in zigzag order; 0 where a band is not sent
    max_planes: tuple[int, ...]
    crc_bits: int  # length of each plane's checksum

    @classmethod
    def of(cls, config: CodecConfig) -> "FrameLayout":
        """Return the layout of a configuration."""
        video, quantised = config.video, config.wyner_ziv
        embedded = quantised.embedded
        return cls(video.height, video.width, embedded, quantised.max_planes, CRC_BITS)

    @cached_property
    def band_shape(self) -> tuple[int, int]:
        """Rows and columns of 4x4 blocks."""
        return transform.band_shape(self.height, self.width)

    @cached_property
    def num_bits(self) -> int:
        """Bits in a plane, which is blocks in a frame."""
        return self.band_shape[0] * self.band_shape[1]

    def over_range(self, step_indices: dict[int, int]) -> Quantization:
        """Return quantisers that share the ranges of their bands."""
        header = pack_digits("".join(_step_digits(step_indices[band]) for band in self._stepped_bands))
        return Quantization(False, self.max_planes, step_indices, header)

    def of_step(self, step_index: int, planes: tuple[int, ...]) -> Quantization:
        """Return quantisers with embedded bins of one width."""
        header = pack_digits(_step_digits(step_index) + plane_digits(planes))
        return Quantization(True, planes, dict.fromkeys(range(transform.NUM_BANDS), step_index), header)

    @property
    def _stepped_bands(self) -> tuple[int, ...]:
        return tuple(band for band, planes in enumerate(self.max_planes) if planes and band > 0)

    def read_header(self, data: bytes) -> Quantization:
        """Read the quantisers of a frame from its header."""
        reader = BitReader(data)
        try:
            if self.embedded:
                index = reader.read_number(quantizer.STEP_INDEX_BITS)
                return self.of_step(index, read_planes(reader))
            bands = self._stepped_bands
            return self.over_range({band: reader.read_number(quantizer.STEP_INDEX_BITS) for band in bands})
        except BitstreamError as err:
            raise BitstreamError(f"header of a Wyner-Ziv frame of {len(data)} bytes: {err}") from err


def _step_digits(index: int) -> str:
    return f"{index:0{quantizer.STEP_INDEX_BITS}b}"


def _unary_digits(difference: int) -> str:
    zeros = 2 * difference if difference > 0 else -2 * difference - (difference < 0)
    return "0" * zeros + "1"


_UNARY_DIGITS = {n: _unary_digits(n) for n in range(-MAX_BAND_PLANES, MAX_BAND_PLANES + 1)}


def plane_digits(planes: tuple[int, ...]) -> str:
    """Spell numbers of planes, each as its difference to that of the band before in unary."""
    differences = [_UNARY_DIGITS[count - before] for before, count in pairwise(planes)]
    return f"{planes[0]:0{_PLANE_COUNT_BITS}b}" + "".join(differences)


def read_planes(reader: BitReader) -> tuple[int, ...]:
    """Read numbers of planes; inverse of `plane_digits`."""
    planes = [reader.read_number(_PLANE_COUNT_BITS)]
    while len(planes) < transform.NUM_BANDS:
        zeros = 0
        while not reader.read_number(1):
            zeros += 1
            if zeros > 2 * MAX_BAND_PLANES:
                raise BitstreamError(f"bit planes of band {len(planes)} out of range")
        planes.append(planes[-1] + (-(zeros + 1) // 2 if zeros % 2 else zeros // 2))
    if not all(0 <= count <= MAX_BAND_PLANES for count in planes):
        raise BitstreamError(f"a band has at most {MAX_BAND_PLANES} bit planes")
    return tuple(planes)
