"""Scalar quantisers of the bands, of two kinds; their bit planes; the header that specifies them.

*Range*, the presets of the literature: a band with ``levels`` = 2^m levels makes m bit planes. DC has
``levels`` bins on [0, 1024). AC has ``levels - 1`` bins, symmetric about zero: the zero bin is (-step, step),
the rest are one step wide and the outermost ends at ``levels / 2`` steps. The step follows from the band's
largest magnitude in the frame and is sent as an index on a logarithmic scale.

*Nested*: all bins of all bands of a frame have one width; a band has as many planes as its values need. Each
plane halves the bins of those before it, so that bins of 2, 4, 8 ... steps are the quantisers of a decoder
that leaves the last planes out. DC begins at zero. In AC bands zero lies one third or two thirds into its
bin at every depth, since 4^n / 3 = 1/3 modulo 1: it is never close to a border, where it would cost bits.

Bit planes come most significant first (offset binary: bins count from the lowest). Planes are numbered over
the whole frame in decoding order: bands in zigzag order, each from its most significant plane down. A frame's
payload starts with its header.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from dvc.bits import BitReader, pack_digits
from dvc.config import CodecConfig
from dvc.config.sections import MAX_BAND_PLANES, NUM_BANDS
from dvc.errors import BitstreamError
from dvc.slepian_wolf import CRC_BITS
from dvc.wynerziv import _kernels, transform

LENGTH_CODE_BITS = 8
_PER_OCTAVE = 16
LENGTHS = (
    0,
    *(_PER_OCTAVE + n % _PER_OCTAVE << n // _PER_OCTAVE for n in range((1 << LENGTH_CODE_BITS) - 1)),
)
"""Lengths of all codes of limits, in bits."""


def length_code(num_bits: float) -> int:
    """Return the code of the least length that is not below one, at most the longest."""
    return bisect_left(LENGTHS, num_bits, 1, len(LENGTHS) - 1) if num_bits > 0 else 0


DC_RANGE = 1024.0
LAMBDA_PER_SQUARED_STEP = 0.1
"""Squared error that a bit must save, in squared steps of embedded quantisers: by `STEP_PER_ROOT_LAMBDA`, and
that steps are rounded up to sixths of octaves, which makes their squares 1.12 times as large in the mean."""
STEP_INDEX_BITS = 6
_PLANE_COUNT_BITS = 4
_SIXTHS = (
    1.0, 1.122462048309373, 1.2599210498948732,
    1.4142135623730951, 1.5874010519681996, 1.7817974362806785,
)  # fmt: skip
"""Powers of the sixth root of two, written out: those of C libraries differ in their last digit."""
_TOLERANCE = 1e-10
"""Share by which a step may exceed that of its index: rounding errors are smaller."""


def power_of_two(sixths: int) -> float:
    """Return two to the power of a number of sixths."""
    octave, rest = divmod(sixths, len(_SIXTHS))
    return math.ldexp(_SIXTHS[rest], octave)


STEPS = [power_of_two(index) for index in range(1 << STEP_INDEX_BITS)]
"""Steps by their indices."""


def index_of_step(step: float) -> int:
    """Return the index of the least step that is not below one."""
    return min(bisect_left(STEPS, step * (1.0 - _TOLERANCE)), len(STEPS) - 1)


def step_index(coefficients: NDArray[np.float64], levels: int) -> int:
    """Return the index of the step of an AC band: 2 |x|max / (levels - 1), as in DISCOVER, rounded up."""
    max_magnitude = float(np.abs(coefficients).max(initial=0.0))
    return index_of_step(2.0 * max_magnitude / (levels - 1))


def bin_edges(levels: int, step: float | None) -> NDArray[np.float64]:
    """Return the borders of the bins of a range quantiser, in increasing order."""
    if step is None:
        return np.arange(levels + 1, dtype=np.float64) * (DC_RANGE / levels)
    positive = np.arange(1, levels // 2 + 1) * step
    edges: NDArray[np.float64] = np.concatenate([-positive[::-1], positive])
    return edges


def embedded_origin(band: int, planes: int) -> float:
    """Return where zero lies among embedded bins."""
    return 0.0 if band == 0 else 4 ** (-(-planes // 2)) / 3


def embedded_edges(band: int, planes: int, step: float) -> NDArray[np.float64]:
    """Return the borders of embedded bins, in increasing order."""
    numbers = np.arange((1 << planes) + 1, dtype=np.float64)
    return (numbers - embedded_origin(band, planes)) * step


ORIGINS = np.array(
    [[embedded_origin(band, planes) for planes in range(MAX_BAND_PLANES + 1)] for band in range(NUM_BANDS)]
)
"""`embedded_origin` by band and number of planes."""


def embedded_planes(extremes: NDArray[np.int16], step: float) -> NDArray[np.int64]:
    """Return how many planes hold all values of each band, before it is scaled, in embedded bins."""
    planes = np.empty(NUM_BANDS, np.int64)
    _kernels.count_planes(extremes, transform.BAND_SCALE, ORIGINS, step, planes)
    return planes


def prefix_borders(
    prefix: NDArray[np.int64], missing_planes: int | NDArray[np.int64], edges: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the intervals of coefficients, given the planes known so far."""
    last = edges.size - 1
    lower = np.minimum(prefix << missing_planes, last)
    upper = np.minimum((prefix + 1) << missing_planes, last)
    return edges[lower], edges[upper]


@dataclass(frozen=True)
class Quantization:
    """Quantisers of the bands of one frame, as its header specifies them."""

    # whether bins are embedded; else their number is given and they share the range of the band
    embedded: bool
    planes: tuple[int, ...]  # bit planes of the 16 bands, in zigzag order; 0 for one that is not sent
    # index in `STEPS` by band; DC has none where its range is given
    step_indices: dict[int, int]
    header: bytes  # all of this, as a frame's payload starts with it
    told_bits: int | None = None  # bits that a group may request because of this frame; None: no limit

    @cached_property
    def bands(self) -> tuple[int, ...]:
        """Bands that are sent, in decoding order."""
        return tuple(band for band, planes in enumerate(self.planes) if planes)

    @cached_property
    def first_plane(self) -> tuple[int, ...]:
        """Frame-wide number of each band's most significant plane, or of the next one if it has none."""
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
        return None if index is None else STEPS[index]

    def zero_bin(self, band: int) -> int:
        """Return the number of the bin of a band that zero is in."""
        planes = self.planes[band]
        return int(embedded_origin(band, planes)) if self.embedded or band == 0 else (1 << planes - 1) - 1

    @property
    def multiplier(self) -> float:
        """Squared error that a bit must save, or its plane is not asked for; 0: all are."""
        step = self.step(0)
        return LAMBDA_PER_SQUARED_STEP * step * step if self.embedded and step else 0.0

    def edges(self, band: int) -> NDArray[np.float64]:
        """Return the borders of a band's bins."""
        step = self.step(band)
        if self.embedded:
            assert step is not None
            return embedded_edges(band, self.planes[band], step)
        return bin_edges(1 << self.planes[band], step)


@lru_cache(maxsize=256)
def quantization_of_step(step_index: int, planes: tuple[int, ...]) -> Quantization:
    """Return quantisers with embedded bins of one width."""
    header = pack_digits(_step_digits(step_index) + _plane_digits(planes))
    return Quantization(True, planes, dict.fromkeys(range(transform.NUM_BANDS), step_index), header)


@dataclass(frozen=True)
class FrameLayout:
    """Layout of the Wyner-Ziv frames of one configuration."""

    height: int  # sides of the luma plane in pixels
    width: int
    embedded: bool  # whether bins are embedded, so that frames differ in their planes
    # most bit planes of the 16 bands, in zigzag order; 0 if a band is not sent
    max_planes: tuple[int, ...]
    crc_bits: int  # length of each plane's checksum
    limited: bool = False  # whether headers limit requests

    @classmethod
    def of(cls, config: CodecConfig) -> "FrameLayout":
        """Return the layout of a configuration."""
        video, quantised = config.video, config.wyner_ziv
        embedded = quantised.embedded
        return cls(video.height, video.width, embedded, quantised.max_planes, CRC_BITS, quantised.limited)

    @cached_property
    def band_shape(self) -> tuple[int, int]:
        """Rows and columns of 4x4 blocks."""
        return transform.band_shape(self.height, self.width)

    @cached_property
    def num_bits(self) -> int:
        """Bits in a plane, which is blocks in a frame."""
        return self.band_shape[0] * self.band_shape[1]

    def over_range(self, step_indices: dict[int, int]) -> Quantization:
        """Return quantisers that share the ranges of their bands; indices of steps by band, in order."""
        header = pack_digits("".join(map(_step_digits, step_indices.values())))
        return Quantization(False, self.max_planes, step_indices, header)

    def read_header(self, data: bytes) -> Quantization:
        """Read the quantisers of a frame from its header."""
        reader = BitReader(data)
        try:
            if self.embedded:
                index = reader.read_number(STEP_INDEX_BITS)
                quantization = quantization_of_step(index, _read_planes(reader))
                size = len(quantization.header) + 1
                if not self.limited:
                    return quantization
                if len(data) < size:
                    raise BitstreamError("the header does not state the limit of requests")
                return replace(quantization, header=data[:size], told_bits=LENGTHS[data[size - 1]])
            bands = [band for band, planes in enumerate(self.max_planes) if planes and band > 0]
            return self.over_range({band: reader.read_number(STEP_INDEX_BITS) for band in bands})
        except BitstreamError as err:
            raise BitstreamError(f"header of a Wyner-Ziv frame of {len(data)} bytes: {err}") from err


def _step_digits(index: int) -> str:
    return f"{index:0{STEP_INDEX_BITS}b}"


def _plane_digits(planes: tuple[int, ...]) -> str:
    """Spell numbers of planes, each as its difference to that of the band before in unary."""
    differences = [count - before for before, count in pairwise(planes)]
    unary = ["0" * (2 * n if n > 0 else -2 * n - (n < 0)) + "1" for n in differences]
    return f"{planes[0]:0{_PLANE_COUNT_BITS}b}" + "".join(unary)


def _read_planes(reader: BitReader) -> tuple[int, ...]:
    """Read numbers of planes; inverse of `_plane_digits`."""
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
