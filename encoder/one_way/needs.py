"""How many planes of a frame pay, and how long their syndromes must be, by residual and noise."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.config import MAX_GOP_LENGTH, USUAL_MARGIN_PERCENT, CodecConfig
from dvc.wynerziv.layout import Quantization
from dvc.wynerziv.one_way import BLOCKS, MAX_BLOCK_BITS, SentPlanes, length_code
from encoder.one_way import _kernels
from encoder.one_way.laplacian import FIRST_OCTAVE, PER_OCTAVE, PER_PLANE, laplacian_tables
from encoder.one_way.sampled_blocks import BlockErrors

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
"""What a bit of ideal code length costs, where planes are chosen: syndrome and margin."""
PAYS = 1.0, 1.5
"""How much more each of `BLOCKS` must be expected to save than it costs: what seems to save much was often
misjudged."""
MARGIN_BITS = 0.08
"""What the margin is of besides the length, for each bit of a plane: small needs are expected the least
reliably."""
REFERENCE_MARGIN = 0.15
"""By which power of what their bits are worth margins of frames that predict others are larger: where one of
these is short, so are those that rest on it."""
REFINED_SHARE = 0.15
"""Of the squared residual of the other bands: what planes of DC save there, at most, since they tell how the
prediction must move."""
OCTAVES = tuple(range(FIRST_OCTAVE, 7, 2))
"""Of the variance over the squared width of bins, where bits are told; from the last on, half a bit each."""


class Needs(NamedTuple):
    """What one of `BLOCKS` needs: fitted to decoded frames by `benchmarks.searches.one_way_needs`."""

    variance: tuple[float, float, float]  # of the error: share of residual and of noise, and what is added
    bits: tuple[float, ...]  # ideal code length of a coefficient, at `OCTAVES`
    anchor_factor: float  # of that where only earlier frames are known


NEEDS = (
    Needs((0.41, 1.4, 0.3), (0.078, 0.078, 0.078, 0.171, 0.341, 0.646, 1.46, 2.36, 3.33, 4.37, 5.46), 1.31),
    Needs((0.3, 1.2, 0.3), (0.002, 0.002, 0.005, 0.005, 0.346, 0.793, 1.0, 1.01, 1.01, 1.01, 1.01), 1.03),
)
"""Of each of `BLOCKS`."""


@lru_cache(maxsize=len(NEEDS))
def _tables(needs: Needs) -> Floats:
    """Return variance, bits and squared error over the variance by places; see `laplacian_tables`."""
    variances, errors = laplacian_tables()
    octaves = np.log2(variances)
    beyond = 0.5 * np.maximum(octaves - OCTAVES[-1], 0.0)
    return np.stack([variances, np.interp(octaves, OCTAVES, needs.bits) + beyond, errors])


class Choice(NamedTuple):
    """What is sent of a frame, and how much of the error is left."""

    sent: SentPlanes
    noise: NDArray[np.float32]  # of the frame as a reference; shape (16, B)


class NeedEstimator:
    """Chooses what to send.

    Parameters
    ----------
    config : CodecConfig
        Configuration of the stream.
    margin_percent : int
        What is sent beyond the need that is expected.
    """

    def __init__(self, config: CodecConfig, margin_percent: int) -> None:
        self._config = config
        self._margin = margin_percent / 100.0

    def choose(self, quantization: Quantization, errors: BlockErrors, distance: int, num_bits: int) -> Choice:
        """Choose planes and lengths of syndromes of one frame.

        Parameters
        ----------
        quantization : Quantization
            Quantisers of the frame.
        errors : BlockErrors
            What is expected of its prediction.
        distance : int
            How far its references are apart, in frames.
        num_bits : int
            Length of a plane.

        Returns
        -------
        Choice
            What to send, and what it leaves.
        """
        if not errors.residual.size:  # too small a picture to tell
            errors = BlockErrors(np.full((16, 1), _UNKNOWN, np.float32), np.zeros((16, 1), np.float32))
        slope = self._config.wyner_ziv.slope_between(distance)
        share = (self._config.wyner_ziv.slope / slope) ** REFERENCE_MARGIN if slope else 1.0
        depths, codes, noise = [], [], np.empty_like(errors.noise)
        for block, needs in enumerate(NEEDS):
            costs = block_costs(quantization, errors, block, needs, num_bits)
            if block == 0:
                _kernels.refine(costs.costs[1, 0], errors.residual[1:], REFINED_SHARE * num_bits)
            chosen, bits, saved = choose_depths(costs, slope)
            size = num_bits * int(chosen.sum())
            need = length_of(bits, needs, distance)
            usual, length = (
                min(need + share * margin * (need + MARGIN_BITS * num_bits), 1.1 * size)
                for margin in (USUAL_MARGIN_PERCENT / 100.0, self._margin)
            )
            if size > MAX_BLOCK_BITS or saved < PAYS[block] * slope * (usual + BLOCK_BITS):
                chosen, length = np.zeros_like(chosen), 0.0
            costs.write_noise(chosen, noise)
            depths += chosen.tolist()
            codes.append(length_code(length))
        return Choice(SentPlanes(tuple(depths), tuple(codes)), noise)


class BlockCosts(NamedTuple):
    """What planes of one of `BLOCKS` are expected to cost and to leave."""

    bands: slice  # in the frame
    planes: Integers  # of each band; shape (bands,)
    step: float  # finest
    places: NDArray[np.int16]  # of the variances, in the tables; shape (bands, B)
    tables: Floats  # of the block; shape (3, NUM_PLACES)
    costs: Floats
    """By bands and planes that are known: ideal code length, and squared error that is left.

    Shape (2, bands, most planes + 1).
    """

    def write_noise(self, depths: Integers, noise: NDArray[np.float32]) -> None:
        """Write the squared error that is left in each block.

        Parameters
        ----------
        depths : ndarray of shape (bands,), int64
            Planes that are known.
        noise : ndarray of shape (16, B), float32
            Of all bands of the frame, of which those of the block are written.
        """
        _kernels.remaining_noise(
            self.places, self.planes, depths, self.step, PER_PLANE, self.tables, noise[self.bands]
        )


def block_costs(
    quantization: Quantization,
    errors: BlockErrors,
    block: int,
    needs: Needs,
    num_bits: int,
) -> BlockCosts:
    """Expect what the planes of a block cost and leave.

    Parameters
    ----------
    quantization : Quantization
        Quantisers of the frame, with nested bins.
    errors : BlockErrors
        What is expected of its prediction.
    block : int
        Number in `BLOCKS`.
    needs : Needs
        Those of the block.
    num_bits : int
        Length of a plane.

    Returns
    -------
    BlockCosts
        Of the whole frame.
    """
    bands = slice(BLOCKS[block].start, BLOCKS[block].stop)
    planes: Integers = np.array(quantization.planes[bands], np.int64)
    step = quantization.step(0)
    assert step is not None
    residual, noise = errors.residual[bands], errors.noise[bands]
    places: NDArray[np.int16] = np.empty(residual.shape, np.int16)
    costs = np.empty((2, len(planes), max(quantization.planes[bands]) + 1))
    scale, tables = num_bits / places.shape[1], _tables(needs)
    _kernels.block_costs(
        residual, noise, needs.variance, planes, step, _FIRST, PER_PLANE, scale, tables, places, costs
    )
    return BlockCosts(bands, planes, step, places, tables, costs)


def choose_depths(costs: BlockCosts, slope: float) -> tuple[Integers, float, float]:
    """Choose how many planes of each band of a block pay.

    Parameters
    ----------
    costs : BlockCosts
        What they cost and leave.
    slope : float
        Squared error that a bit must save.

    Returns
    -------
    depths : ndarray of shape (bands,), int64
        Planes that are sent.
    bits : float
        Their ideal code length.
    saved : float
        The squared error that they save.
    """
    depths = np.empty_like(costs.planes)
    bits, saved = _kernels.choose_depths(costs.costs, costs.planes, BITS_PER_BIT * slope, depths)
    return depths, bits, saved


def length_of(bits: float, needs: Needs, distance: int) -> float:
    """Return the length of the shortest syndrome that is expected to serve.

    Parameters
    ----------
    bits : float
        Ideal code length of the planes of a block, from `choose_depths`.
    needs : Needs
        Those of the block.
    distance : int
        How far the references are apart, in frames.

    Returns
    -------
    float
        In bits; 0 where nothing is sent.
    """
    if distance > MAX_GOP_LENGTH // 2:
        bits *= needs.anchor_factor
    return CODE_RATIO[0] * bits + CODE_RATIO[1] * math.sqrt(bits)
