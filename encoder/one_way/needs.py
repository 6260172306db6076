"""How many planes of a frame pay, and how long their syndromes must be, by the residual that tracks leave."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig
from dvc.wynerziv.layout import Quantization
from dvc.wynerziv.one_way import BLOCKS, MAX_BLOCK_BITS, SentPlanes, length_code

Floats = NDArray[np.float64]

_RATIOS_PER_OCTAVE = 8
_OCTAVES = (-7, 4)
_LOCAL_SHARE = 0.9
"""Of the scale, that is of the block itself; the rest is of the whole band."""
_SCALE_PER_MAGNITUDE = (1.6, 0.5)
"""Scale of the decoder's error over the mean magnitude of the residual, for each of `BLOCKS`."""
_NOISE_PER_ROOT_SLOPE = 0.1
"""Scale of what quantised references add."""
_MIN_SCALE = 0.3
_CODE_FACTOR = 1.14
"""Length of the shortest syndrome that serves, over the ideal code length; by hand, as all of these."""
_BITS_PER_SAVED = 1.25
"""Bits that an ideal one costs, where planes are chosen."""
_NEEDS = {
    2: ((107.0, 0.81), (0.0, 0.87)),
    4: ((166.0, 0.56), (11.0, 0.73)),
    8: ((381.0, 0.55), (8.0, 0.79)),
    16: ((100.0, 0.71), (24.0, 0.71)),
}
_ANCHOR_NEEDS = ((100.0, 0.92), (36.0, 1.78))
"""By how far the references are apart, for each of `BLOCKS`: bits that a band needs anyway, and bits for each
that the residual tells. Fitted by hand to box, desk, river and tree at QP 28 or 32, planes of 6,336 bits."""
_FITTED_BITS = 6336


@lru_cache(maxsize=1)
def _tables() -> tuple[Floats, Floats]:
    """Return entropy, and squared error of the mean, of a Laplacian in bins, by its scale in bins."""
    exponents = np.arange(_OCTAVES[0] * _RATIOS_PER_OCTAVE, _OCTAVES[1] * _RATIOS_PER_OCTAVE + 1)
    sample = np.linspace(-12.0, 12.0, 1441)  # in scales
    density = np.exp(-np.abs(sample))
    density /= density.sum()
    entropy, error = np.zeros(exponents.size), np.zeros(exponents.size)
    offsets = (np.arange(8) + 0.5) / 8
    for k, exponent in enumerate(exponents):
        for offset in offsets:
            bins = np.floor(sample * 2.0 ** (exponent / _RATIOS_PER_OCTAVE) + offset).astype(np.int64)
            bins -= bins[0]
            mass = np.bincount(bins, density)
            first, second = np.bincount(bins, density * sample), np.bincount(bins, density * sample**2)
            own = mass > 0
            mass, first, second = mass[own], first[own], second[own]
            entropy[k] -= float((mass * np.log2(mass)).sum()) / offsets.size
            error[k] += float((second - first * first / mass).sum()) / offsets.size
    return entropy, error


@dataclass(frozen=True)
class NeedEstimator:
    """Chooses what to send.

    Attributes
    ----------
    config : CodecConfig
        Configuration of the stream.
    margin_percent : int
        What is sent beyond the need that is expected.
    """

    config: CodecConfig
    margin_percent: int

    def choose(
        self, quantization: Quantization, magnitudes: Floats, distance: int, num_bits: int
    ) -> SentPlanes:
        """Choose planes and lengths of syndromes of one frame.

        Parameters
        ----------
        quantization : Quantization
            Quantisers of the frame.
        magnitudes : ndarray of shape (B, 16), float64
            What its residual is, from `residual_magnitudes`.
        distance : int
            How far its references are apart, in frames.
        num_bits : int
            Length of a plane.

        Returns
        -------
        SentPlanes
            What to send.
        """
        slope = self.config.wyner_ziv.slope_between(distance)
        depths, codes = [0] * 16, []
        for block, share, needs in zip(BLOCKS, _SCALE_PER_MAGNITUDE, _needs(distance), strict=True):
            expected, num_bands = 0.0, 0
            for band in block:
                step, planes = quantization.step(band), quantization.planes[band]
                assert step is not None
                scales = self._scales(magnitudes[:, band], share)
                depths[band], bits = _depth(scales, step, planes, slope, num_bits)
                expected += bits
                num_bands += depths[band] > 0
            fixed = needs[0] * num_bands * num_bits / _FITTED_BITS
            needed = _CODE_FACTOR * (1.0 + self.margin_percent / 100.0) * (fixed + needs[1] * expected)
            size = num_bits * sum(depths[band] for band in block)
            codes.append(length_code(min(needed, 1.1 * size)) if size <= MAX_BLOCK_BITS else 0)
        return SentPlanes(tuple(depths), tuple(codes))

    def _scales(self, magnitudes: Floats, share: float) -> Floats:
        """Return the scale of the decoder's error in each block of a band."""
        if not len(magnitudes):
            return np.full(1, 255.0)
        noise = _NOISE_PER_ROOT_SLOPE**2 * self.config.wyner_ziv.slope + _MIN_SCALE**2
        local = _LOCAL_SHARE * magnitudes + (1.0 - _LOCAL_SHARE) * magnitudes.mean()
        scales: Floats = np.sqrt((share * local) ** 2 + noise)
        return scales


def _depth(scales: Floats, step: float, planes: int, slope: float, num_bits: int) -> tuple[int, float]:
    """Return how many planes of a band pay, and their expected bits."""
    entropy, error = _tables()
    exponents = _RATIOS_PER_OCTAVE * np.log2(scales / step)
    weight = num_bits / len(scales)
    best, chosen = 2.0 * float((scales**2).sum()) * weight, (0, 0.0)
    for depth in range(1, planes + 1):
        place = np.rint(exponents - _RATIOS_PER_OCTAVE * (planes - depth)).astype(np.int64)
        place = np.clip(place - _OCTAVES[0] * _RATIOS_PER_OCTAVE, 0, entropy.size - 1)
        bits = float(entropy[place].sum()) * weight
        cost = float((scales**2 * error[place]).sum()) * weight + slope * _BITS_PER_SAVED * bits
        if cost < best:
            best, chosen = cost, (depth, bits)
    return chosen


def _needs(distance: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return needs by how far the references are apart."""
    if distance > 2 * max(_NEEDS):
        return _ANCHOR_NEEDS
    return next((needs for level, needs in _NEEDS.items() if distance <= level), _NEEDS[max(_NEEDS)])
