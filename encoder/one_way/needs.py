"""How many planes of a frame pay, and how long their syndromes must be, by residual and noise."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.config import MAX_GOP_LENGTH, CodecConfig
from dvc.wynerziv.layout import Quantization
from dvc.wynerziv.one_way import BLOCKS, MAX_BLOCK_BITS, SentPlanes, length_code
from encoder.one_way import _kernels
from encoder.one_way.laplacian import FIRST_OCTAVE, PER_OCTAVE, PER_PLANE, laplacian_tables
from encoder.one_way.sampled_blocks import BlockErrors

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_FIRST = (127 + FIRST_OCTAVE) * PER_OCTAVE  # of single precision: exponent and three bits after it
_SHIFT = PER_PLANE, 2 * PER_OCTAVE
"""Places of a plane; and by how many variances are lower where needs are told."""
_FITTED_BITS = 6336
_UNKNOWN = 255.0**2
_LEAST_BITS = 100.0
BLOCK_BITS = 40
"""What a block costs beside its syndrome: check bits, and numbers of planes."""
BITS_PER_BIT = 1.3
"""What a bit of expected entropy costs, where planes are chosen."""


class Needs(NamedTuple):
    """What one of `BLOCKS` needs: fitted to decoded frames by `benchmarks.searches.one_way_needs`."""

    variance: tuple[float, float, float]  # of the error: share of residual and of noise, and what is added
    factor: float  # of the expected bits
    exponent: float  # of the expected bits
    anchor_factor: float  # the same where only earlier frames are known


NEEDS = (
    Needs((0.48, 1.28, 0.3), 19.4, 0.753, 1.14),
    Needs((0.42, 1.04, 0.3), 4.19, 0.935, 1.04),
)
"""Of each of `BLOCKS`; lengths of syndromes that just serve."""


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
        self._margin = 1.0 + margin_percent / 100.0

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
        depths, codes, noise = [], [], np.empty_like(errors.noise)
        for block, needs in enumerate(NEEDS):
            costs = block_costs(quantization, errors, block, needs.variance, num_bits)
            chosen, bits, saved = choose_depths(costs, slope)
            size = num_bits * int(chosen.sum())
            length = min(self._margin * length_of(bits, needs, distance, num_bits), 1.1 * size)
            if saved < slope * (length + BLOCK_BITS):
                chosen, length = np.zeros_like(chosen), 0.0
            costs.write_noise(chosen, noise)
            depths += chosen.tolist()
            codes.append(length_code(length) if size <= MAX_BLOCK_BITS else 0)
        return Choice(SentPlanes(tuple(depths), tuple(codes)), noise)


class BlockCosts(NamedTuple):
    """What planes of one of `BLOCKS` are expected to cost and to leave."""

    bands: slice  # in the frame
    planes: Integers  # of each band; shape (bands,)
    step: float  # finest
    places: NDArray[np.int16]  # of the variances, in the tables; shape (bands, B)
    costs: Floats
    """By bands and planes that are known: entropy, bits that tell the need, squared error that is left.

    Shape (3, bands, most planes + 1).
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
        left, tables = noise[self.bands], laplacian_tables()
        _kernels.remaining_noise(self.places, self.planes, depths, self.step, PER_PLANE, tables, left)


def block_costs(
    quantization: Quantization,
    errors: BlockErrors,
    block: int,
    variance: tuple[float, float, float],
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
    variance : tuple of float
        See `Needs`.
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
    costs = np.empty((3, len(planes), max(quantization.planes[bands]) + 1))
    scale, tables = num_bits / places.shape[1], laplacian_tables()
    _kernels.block_costs(
        residual, noise, variance, planes, step, _FIRST, _SHIFT, scale, tables, places, costs
    )
    return BlockCosts(bands, planes, step, places, costs)


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
        The bits that tell what these need.
    saved : float
        The squared error that they save.
    """
    depths = np.empty_like(costs.planes)
    bits, saved = _kernels.choose_depths(costs.costs, costs.planes, BITS_PER_BIT * slope, depths)
    return depths, bits, saved


def length_of(bits: float, needs: Needs, distance: int, num_bits: int) -> float:
    """Return the length of the shortest syndrome that is expected to serve.

    Parameters
    ----------
    bits : float
        What tells the need of a block, from `choose_depths`.
    needs : Needs
        Those of the block.
    distance : int
        How far the references are apart, in frames.
    num_bits : int
        Length of a plane.

    Returns
    -------
    float
        In bits; 0 where nothing is sent.
    """
    if bits <= 0:
        return 0.0
    size = num_bits / _FITTED_BITS
    length = needs.factor * (bits / size + _LEAST_BITS) ** needs.exponent
    return float(size * length * (needs.anchor_factor if distance > MAX_GOP_LENGTH // 2 else 1.0))
