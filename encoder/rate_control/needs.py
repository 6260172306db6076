"""Which planes of a frame are worth their rate, and how long syndromes must be, by residual and noise."""

from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig, EstimatedRate
from dvc.wynerziv.lengths import length_code
from dvc.wynerziv.no_feedback import BLOCKS, SentPlanes
from dvc.wynerziv.quantizer import Quantization
from encoder.rate_control import _kernels
from encoder.rate_control.laplacian import FIRST_OCTAVE, PER_OCTAVE, PER_PLANE, laplacian_tables
from encoder.rate_control.sampled_blocks import BlockErrors

Floats = NDArray[np.float64]

_FIRST = (127 + FIRST_OCTAVE) * PER_OCTAVE  # of single precision: exponent and three bits after it
_UNKNOWN = 255.0**2
BITS_PER_BIT = 1.6
"""What a bit of ideal code length costs, where planes are chosen: syndrome and rate margin."""
MIN_WORTH = 1.0, 1.5
"""How much more each of `BLOCKS` must be expected to save than it costs: what seems to save much was often
misjudged."""
REFERENCE_RATE_MARGIN = 0.15
"""Power of what their bits are worth by which rate margins of frames that predict others are larger: where
one of these is short, so are those that rest on it."""
REFINED_SHARE = 0.15
"""Of the squared residual of the other bands: what planes of DC save there, at most, since they tell how the
prediction must move."""
OCTAVES = tuple(range(FIRST_OCTAVE, 7, 2))
"""Of the variance over the squared width of bins, where bits are told; from the last on, half a bit each."""


class Needs(NamedTuple):
    """What one of `BLOCKS` needs: fitted to decoded frames by `benchmarks.searches.rate_needs`."""

    variance: tuple[float, float, float]  # of the error: share of residual and of noise, and what is added
    bits: tuple[float, ...]  # ideal code length of a coefficient, at `OCTAVES`


NEEDS = (
    Needs((0.41, 1.4, 0.3), (0.078, 0.078, 0.078, 0.171, 0.341, 0.646, 1.46, 2.36, 3.33, 4.37, 5.46)),
    Needs((0.3, 1.2, 0.3), (0.002, 0.002, 0.005, 0.005, 0.346, 0.793, 1.0, 1.01, 1.01, 1.01, 1.01)),
)
"""Of each of `BLOCKS`."""
_LEAST = np.array(MIN_WORTH)


@lru_cache(maxsize=1)
def _cost_model() -> _kernels.CostModel:
    """Tabulate variance, squared error over it, and bits of each of `BLOCKS`, by places."""
    variances, errors = laplacian_tables()
    octaves = np.log2(variances)
    beyond = 0.5 * np.maximum(octaves - OCTAVES[-1], 0.0)
    bits = [np.interp(octaves, OCTAVES, needs.bits) + beyond for needs in NEEDS]
    borders, weights = np.array([0, *(bands.stop for bands in BLOCKS)]), [needs.variance for needs in NEEDS]
    tables = np.stack([variances, errors, *bits])
    return _kernels.CostModel(borders, np.array(weights), _FIRST, PER_PLANE, REFINED_SHARE, tables)


class Choice(NamedTuple):
    """What is sent of a frame, and how much of the error is left."""

    sent: SentPlanes
    noise: NDArray[np.float32]  # of the frame as a reference; shape (16, B)
    costs: Floats
    """By bands and planes that are known: ideal code length, and squared error that is left.

    Shape (16, 2, most planes + 1).
    """


class NeedEstimator:
    """Chooses what to send."""

    def __init__(self, config: CodecConfig, rate_margin_percent: int) -> None:
        self._wyner_ziv = config.wyner_ziv
        self._worth = cache(self._worth_of)
        self._margins = EstimatedRate.rate_margin_percent / 100.0, rate_margin_percent / 100.0

    def choose(self, quantization: Quantization, errors: BlockErrors, distance: int, num_bits: int) -> Choice:
        """Choose planes and lengths of syndromes of one frame."""
        residual, noise = errors.residual, errors.noise
        if not residual.size:  # too small a picture to tell
            residual, noise = np.full((16, 1), _UNKNOWN, np.float32), np.zeros((16, 1), np.float32)
        step, planes = quantization.step(0), quantization.plane_counts
        assert step is not None
        costs = np.empty((len(planes), 2, max(quantization.planes) + 1))
        depths, lengths = np.empty_like(planes), np.empty(len(BLOCKS))
        left = np.empty(residual.shape, np.float32)
        worth = self._worth(quantization.multiplier, distance)
        bands, sent = (planes, step, num_bits), (depths, lengths)
        _kernels.choose((residual, noise), bands, _cost_model(), worth, costs, sent, left)
        codes = tuple(map(length_code, lengths.tolist()))
        return Choice(SentPlanes(tuple(depths.tolist()), codes), left, costs)

    def _worth_of(self, multiplier: float, distance: int) -> _kernels.Worth:
        (usual, margin), share = self._margins, self._margin_share(distance)
        return _kernels.Worth(multiplier, BITS_PER_BIT, _LEAST, (share * usual, share * margin))

    def _margin_share(self, distance: int) -> float:
        """Return by what margins are larger where references are so far apart."""
        return float(
            (self._wyner_ziv.step(2) / self._wyner_ziv.step(distance)) ** (2 * REFERENCE_RATE_MARGIN)
        )
