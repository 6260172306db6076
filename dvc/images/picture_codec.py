"""A picture or a map as an embedded stream, and back.

Planes (gray, or luma and chroma) are transformed, and all their coefficients coded together: chroma is scaled
by `CHROMA_WEIGHT`, so its bit planes come among those of luma. Any part of the bytes from the beginning is a
picture that depends on these bytes only: an encoder calls `decode` for the picture of a decoder.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvc.errors import BitstreamError
from dvc.images import zerotree_coder
from dvc.images.colour import rgb_from_ycbcr, ycbcr_from_rgb
from dvc.images.edge_maps import EdgeMaps, Mask
from dvc.images.lifting import (
    WAVELETS,
    Pyramid,
    Transform,
    low_band_gain,
    mask_pyramid,
    most_levels,
    scale_shapes,
)
from dvc.images.zerotree_coder import (
    MAX_PLANES,
    Band,
    Forest,
    Shape,
    scatter,
    significance_maps,
    zerotrees,
)

STEP = 0.25
"""Step of the quantiser after all bit planes, in steps of 8-bit intensities."""
CHROMA_WEIGHT = 0.5
"""Factor on chroma coefficients; its square is the weight of errors of chroma relative to luma."""
LARGEST_MULTIPLIER, SMALLEST_MULTIPLIER = 10.0, 1e-8
"""Multipliers at which almost nothing is coded, and everything."""
DEFAULT_LEVELS = 6
MAX_LEVELS = 15
_MULTIPLIER_STEPS = 40
_MOST_GAIN = 16.0
_MIDDLE = 128.0
_PEAK = 255.0
_SCALES = ((_MIDDLE, 1.0), (0.0, CHROMA_WEIGHT), (0.0, CHROMA_WEIGHT))  # middle and weight of each plane
_ROWS_AT_ONCE = 16
_POINT_STEP, _FIRST_POINT, _NUM_POINTS = 1 / 32, 2, 16


@dataclass(frozen=True)
class PictureHeader:
    """Parameters of a decoder besides size and data: three bytes."""

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


@dataclass(frozen=True)
class DecodedPicture:
    """A decoded picture."""

    # gray, or Y, Cb and Cr; intensities from 0 to 255, neither rounded nor clipped
    planes: NDArray[np.float64]
    # significance of coefficients (3.3), from j = 1 on, down to one pixel; of the full resolution
    significance: list[NDArray[np.bool_]]

    def picture(self) -> NDArray[np.uint8]:
        """Return the picture."""
        channels = () if len(self.planes) == 1 else (3,)
        found = np.empty((*self.planes.shape[1:], *channels), np.uint8)
        for row in range(0, len(found), _ROWS_AT_ONCE):
            part = self.planes[:, row : row + _ROWS_AT_ONCE]
            exact = rgb_from_ycbcr(part) if channels else part[0]
            found[row : row + _ROWS_AT_ONCE] = np.clip(np.rint(exact), 0.0, _PEAK)
        return found


@dataclass(frozen=True)
class PictureCode:
    """An encoded picture, to be cut at any length."""

    header: PictureHeader  # the header, of usual points
    data: bytes = field(repr=False)  # all data
    shape: Shape  # rows and columns
    # lengths at which the data may be cut, increasing; the header is not counted
    bits_per_pixel: NDArray[np.float64]
    # mean squared error at these, intensities from 0 to 1, of coefficients, which is some percent less than
    # that of pixels; chroma counts by its weight
    mse: NDArray[np.float64]
    _forest: Forest = field(repr=False)
    _coefficients: NDArray[np.float64] = field(repr=False)

    def bytes_at_multiplier(self, multiplier: float) -> int:
        """Return the length at which the last bits were worth a multiplier."""
        best = int(np.argmin(self.mse + multiplier * self.bits_per_pixel))
        num_pixels = self.shape[0] * self.shape[1]
        return min(round(float(self.bits_per_pixel[best]) * num_pixels / 8), len(self.data))

    def cut(self, num_bytes: int) -> tuple[PictureHeader, bytes]:
        """Return a part, and its best header."""
        data = self.data[: max(num_bytes, 0)]
        known = zerotree_coder.decode(self._forest, data, self.header.num_bit_planes, self.header.adaptive)
        fitted = [
            min(max(round(point / _POINT_STEP) - _FIRST_POINT, 0), _NUM_POINTS - 1)
            for point in known.fitted_points(self._coefficients)
        ]
        return replace(self.header, points=(fitted[0], fitted[1])), data


def lowest_plane_at(multiplier: float) -> int:
    """Return the bit plane after which no bits are worth a multiplier."""
    threshold = math.sqrt(multiplier / _MOST_GAIN) * _PEAK / STEP
    return max(math.floor(math.log2(threshold)), 0) if threshold > 1.0 else 0


def multipliers_around(codes: Sequence[Any], num_bytes: float) -> tuple[float, float]:
    """Return the multipliers between which the codes of pictures pass a length."""
    low, high = math.log(SMALLEST_MULTIPLIER), math.log(LARGEST_MULTIPLIER)
    for _ in range(_MULTIPLIER_STEPS):
        middle = 0.5 * (low + high)
        if sum(code.bytes_at_multiplier(math.exp(middle)) for code in codes) > num_bytes:
            low = middle
        else:
            high = middle
    return math.exp(low), math.exp(high)


def encode(
    picture: ArrayLike,
    max_bytes: int | None = None,
    num_levels: int | None = None,
    wavelet: str = "9/7",
    adaptive: bool = True,
    edges: EdgeMaps | None = None,
    order: int = 0,
    lowest_plane: int = 0,
    mask: Mask | None = None,
) -> PictureCode:
    """Code a picture."""
    samples = np.asarray(picture, np.float64)
    if samples.ndim not in (2, 3) or samples.shape[2:] not in ((), (3,)) or not samples.size:
        raise ValueError(f"`picture` must be of shape (H, W) or (H, W, 3), not empty, got {samples.shape}")
    components = samples[np.newaxis] if samples.ndim == 2 else ycbcr_from_rgb(samples)
    planes = [(plane - middle) * weight for plane, (middle, weight) in zip(components, _SCALES, strict=False)]
    shape = samples.shape[0], samples.shape[1]
    if num_levels is None:
        num_levels = min(DEFAULT_LEVELS, most_levels(shape))
    if not 0 <= num_levels <= MAX_LEVELS:
        raise ValueError(f"`num_levels` must be from 0 to {MAX_LEVELS}, got {num_levels}")
    if wavelet not in WAVELETS:
        raise ValueError(f"`wavelet` must be one of {', '.join(WAVELETS)}, got {wavelet!r}")
    forest = _forest(shape, num_levels, len(planes) == 3, mask)
    transform = Transform(num_levels, wavelet, edges, order, mask)
    pyramids = [transform.analyse(plane) for plane in planes]
    coefficients = forest.gather(pyramids)
    del pyramids
    coefficients /= STEP
    code = zerotree_coder.encode(forest, coefficients, max_bytes, adaptive, lowest_plane)
    header = PictureHeader(num_levels, code.num_planes, len(planes) == 3, wavelet, adaptive)
    num_pixels = shape[0] * shape[1]
    mse = code.squared_error * (STEP / _PEAK) ** 2 / num_pixels
    return PictureCode(header, code.data, shape, code.bits / num_pixels, mse, forest, coefficients)


def decode(
    header: PictureHeader,
    data: bytes,
    shape: Shape,
    num_skipped_levels: int = 0,
    edges: EdgeMaps | None = None,
    order: int = 0,
    mask: Mask | None = None,
) -> DecodedPicture:
    """Decode a picture from the beginning of its code."""
    if not 0 <= num_skipped_levels <= header.num_levels:
        raise ValueError(
            f"`num_skipped_levels` must be from 0 to {header.num_levels}, got {num_skipped_levels}"
        )
    size = scale_shapes(shape, num_skipped_levels)[-1]
    scales = _SCALES[: 3 if header.colour else 1]
    if not data or not header.num_bit_planes:
        middles = np.array([middle for middle, _ in scales])[:, None, None]
        shapes = scale_shapes(shape, most_levels(shape))[1:]
        significance = [np.full(each, k >= header.num_levels) for k, each in enumerate(shapes)]
        return DecodedPicture(np.broadcast_to(middles, (len(scales), *size)), significance)
    forest = _forest(shape, header.num_levels, header.colour, mask)
    known = zerotree_coder.decode(forest, data, header.num_bit_planes, header.adaptive)
    bands = forest.bands
    del forest  # its trees are large
    points = tuple((point + _FIRST_POINT) * _POINT_STEP for point in header.points)

    def _coefficients(band: Band) -> NDArray[np.float64]:
        if band.kind and band.level <= num_skipped_levels:
            return np.zeros((0, 0))
        found = known.part(band).reconstruct((points[0], points[1]))
        return np.multiply(found, STEP, out=found)

    transform = Transform(header.num_levels, header.wavelet, edges, order, mask)
    gain, planes = low_band_gain(shape, num_skipped_levels), np.empty((len(scales), *size))
    pyramids = scatter(bands, _coefficients)  # one plane after the other: pictures may be large
    for k, pyramid in enumerate(pyramids):
        kept = Pyramid(pyramid.low, pyramid.details[num_skipped_levels:])
        np.divide(transform.synthesise(kept), gain * scales[k][1], out=planes[k])
        planes[k] += scales[k][0]
    return DecodedPicture(planes, significance_maps(bands, known, shape, most_levels(shape)))


def _forest(shape: Shape, num_levels: int, colour: bool, mask: Mask | None) -> Forest:
    num_planes = 3 if colour else 1
    masks = None if mask is None else [mask_pyramid(mask, num_levels)] * num_planes
    return zerotrees([shape] * num_planes, [num_levels] * num_planes, masks)
