"""Which planes of a frame are worth their rate, and how long syndromes must be, by residual and noise."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.config import MAX_GOP_LENGTH, CodecConfig, EstimatedRate
from dvc.wynerziv.no_feedback import BLOCKS, MAX_BLOCK_BITS, SentPlanes, length_code
from dvc.wynerziv.quantizer import Quantization
from encoder.rate_control import _kernels
from encoder.rate_control.laplacian import FIRST_OCTAVE, PER_OCTAVE, PER_PLANE, laplacian_tables
from encoder.rate_control.sampled_blocks import BlockErrors

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_FIRST = (127 + FIRST_OCTAVE) * PER_OCTAVE  # of single precision: exponent and three bits after it
_UNKNOWN = 255.0**2
BLOCK_BITS = 40
"""What a block costs beside its syndrome: check bits, and numbers of planes."""
CODE_RATIO = 1.12, 4.0
"""Length of the shortest syndrome that serves over the ideal code length: for long blocks, and what is added
over the root of the bits of short ones."""
BITS_PER_BIT = 1.6
"""What a bit of ideal code length costs, where planes are chosen: syndrome and rate margin."""
MIN_WORTH = 1.0, 1.5
"""How much more each of `BLOCKS` must be expected to save than it costs: what seems to save much was often
misjudged."""
RATE_MARGIN_BITS = 0.08
"""What the rate margin is of besides the length, for each bit of a plane: small needs are expected the least
reliably."""
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
    p_type_factor: float  # of that where only earlier frames are known


NEEDS = (
    Needs((0.41, 1.4, 0.3), (0.078, 0.078, 0.078, 0.171, 0.341, 0.646, 1.46, 2.36, 3.33, 4.37, 5.46), 1.31),
    Needs((0.3, 1.2, 0.3), (0.002, 0.002, 0.005, 0.005, 0.346, 0.793, 1.0, 1.01, 1.01, 1.01, 1.01), 1.03),
)
"""Of each of `BLOCKS`."""
_BANDS = tuple(slice(bands.start, bands.stop) for bands in BLOCKS)
_BORDERS = np.array([0, *(bands.stop for bands in BLOCKS)])
_VARIANCES = np.array([needs.variance for needs in NEEDS])


@lru_cache(maxsize=1)
def _tables() -> Floats:
    """Return variance, bits of each of `BLOCKS`, and squared error over the variance by places."""
    variances, errors = laplacian_tables()
    octaves = np.log2(variances)
    beyond = 0.5 * np.maximum(octaves - OCTAVES[-1], 0.0)
    bits = [np.interp(octaves, OCTAVES, needs.bits) + beyond for needs in NEEDS]
    return np.stack([variances, errors, *bits])


class Choice(NamedTuple):
    """What is sent of a frame, and how much of the error is left."""

    sent: SentPlanes
    noise: NDArray[np.float32]  # of the frame as a reference; shape (16, B)


class NeedEstimator:
    """Chooses what to send."""

    def __init__(self, config: CodecConfig, rate_margin_percent: int) -> None:
        self._config = config
        self._margin = rate_margin_percent / 100.0

    def choose(self, quantization: Quantization, errors: BlockErrors, distance: int, num_bits: int) -> Choice:
        """Choose planes and lengths of syndromes of one frame."""
        if not errors.residual.size:  # too small a picture to tell
            errors = BlockErrors(np.full((16, 1), _UNKNOWN, np.float32), np.zeros((16, 1), np.float32))
        multiplier, wyner_ziv = quantization.multiplier, self._config.wyner_ziv
        share = (wyner_ziv.step(2) / wyner_ziv.step(distance)) ** (2 * REFERENCE_RATE_MARGIN)
        costs = frame_costs(quantization, errors, num_bits)
        depths, codes = np.empty_like(costs.planes), []
        for bands, worth, needs in zip(_BANDS, MIN_WORTH, NEEDS, strict=True):
            num_planes, bits, saved = costs.choose_depths(bands, multiplier, depths)
            size = num_bits * num_planes
            need = length_of(bits, needs, distance)
            usual, length = (
                min(need + share * margin * (need + RATE_MARGIN_BITS * num_bits), 1.1 * size)
                for margin in (EstimatedRate.rate_margin_percent / 100.0, self._margin)
            )
            if size > MAX_BLOCK_BITS or saved < worth * multiplier * (usual + BLOCK_BITS):
                depths[bands], length = 0, 0.0
            codes.append(length_code(length))
        return Choice(SentPlanes(tuple(depths.tolist()), tuple(codes)), costs.noise(depths))


class FrameCosts(NamedTuple):
    """What planes of a frame are expected to cost and to leave."""

    planes: Integers  # of each band; shape (16,)
    step: float  # finest
    places: NDArray[np.int16]  # of the variances, in the tables; shape (16, B)
    costs: Floats
    """By bands and planes that are known: ideal code length, and squared error that is left.

    Shape (16, 2, most planes + 1).
    """

    def choose_depths(self, bands: slice, multiplier: float, depths: Integers) -> tuple[int, float, float]:
        """Choose how many planes of some bands are worth their rate."""
        given = self.costs[bands], self.planes[bands], BITS_PER_BIT * multiplier
        num_planes, bits, saved = _kernels.choose_depths(*given, depths[bands])
        return num_planes, bits, saved

    def noise(self, depths: Integers) -> NDArray[np.float32]:
        """Return the squared error that is left in each block."""
        noise = np.empty(self.places.shape, np.float32)
        _kernels.remaining_noise(self.places, self.planes, depths, self.step, PER_PLANE, _tables(), noise)
        return noise


def frame_costs(quantization: Quantization, errors: BlockErrors, num_bits: int) -> FrameCosts:
    """Expect what the planes of a frame cost and leave."""
    planes: Integers = np.array(quantization.planes, np.int64)
    step = quantization.step(0)
    assert step is not None
    places: NDArray[np.int16] = np.empty(errors.residual.shape, np.int16)
    costs = np.empty((len(planes), 2, max(quantization.planes) + 1))
    _kernels.frame_costs(
        errors.residual,
        errors.noise,
        planes,
        step,
        num_bits,
        _kernels.CostModel(_BORDERS, _VARIANCES, _FIRST, PER_PLANE, REFINED_SHARE, _tables()),
        places,
        costs,
    )
    return FrameCosts(planes, step, places, costs)


def length_of(bits: float, needs: Needs, distance: int) -> float:
    """Return the length of the shortest syndrome that is expected to serve."""
    if distance > MAX_GOP_LENGTH // 2:
        bits *= needs.p_type_factor
    return CODE_RATIO[0] * bits + CODE_RATIO[1] * math.sqrt(bits)
