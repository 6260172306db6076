"""What choosing without a decoder takes in operations: a model of the blocks that are looked at."""

from dvc.wynerziv.transform import BLOCK, NUM_BANDS
from encoder.one_way import _kernels
from encoder.one_way.sampled_blocks import BLOCK_PX, OneWayWork
from encoder.operations import Operations

_SAMPLES = BLOCK_PX * BLOCK_PX
_PARTS = _SAMPLES // (BLOCK * BLOCK)


def nearest(num_distances: float) -> Operations:
    """Count which points are nearest to blocks; to keep the order of the few that are is left out.

    Parameters
    ----------
    num_distances : float
        Pairs of a block and a point.

    Returns
    -------
    Operations
        The squared distance, and whether it is small.
    """
    return Operations(adds=3, multiplies=2, compares=1, bytes=3 * 8).times(num_distances)


def moved(num_moved: float) -> Operations:
    """Count where blocks come from in a reference, at half samples, and the noise there.

    Parameters
    ----------
    num_moved : float
        Blocks.

    Returns
    -------
    Operations
        By three points, inside the picture.
    """
    motion = Operations(adds=3 * 4 + 2, multiplies=3 * 3 + 4, compares=3 + 1, bytes=3 * 4 * 8 + 4 * 8)
    samples = Operations(adds=4, bytes=4 + 2 * 4).times(_SAMPLES)
    noise = Operations(adds=1, bytes=3 * 8).times(NUM_BANDS)
    return (motion + samples + noise).times(num_moved)


def core() -> Operations:
    """Count the 4x4 transform of a part of a block, without sums that are used twice.

    Returns
    -------
    Operations
        Of 32-bit integers.
    """
    line = Operations(adds=4 * 3, multiplies=2, bytes=2 * BLOCK * 4)
    return line.times(2 * BLOCK)


def residual(num_blocks: float) -> Operations:
    """Count the residual of blocks, its energy by bands, and where it stands in the tables of needs.

    Parameters
    ----------
    num_blocks : float
        Blocks.

    Returns
    -------
    Operations
        What depends on the tables alone, a fraction of an operation a pixel, is left out.
    """
    difference = Operations(adds=1, multiplies=1, bytes=1 + 2 * 4).times(_SAMPLES)
    squares = Operations(adds=1, multiplies=1, bytes=2 * 4 + 2 * 8).times(_SAMPLES)
    means = Operations(multiplies=1, bytes=8 + 3 * 8).times(NUM_BANDS)
    place = Operations(multiplies=3, adds=2 + 1 + 1, logic=1, compares=2, bytes=2 * 8 + 2 * 4 + 2 * 8 + 2 * 8)
    left = Operations(multiplies=3, adds=1, compares=1, bytes=3 * 8 + 8 + 3 * 8)
    bands = (place + left).times(NUM_BANDS)
    return (difference + core().times(_PARTS) + squares + means + bands).times(num_blocks)


def intra_noise(num_intra: float) -> Operations:
    """Count what quantisation leaves of blocks of key frames, predicted in the best of three directions.

    Parameters
    ----------
    num_intra : float
        Blocks.

    Returns
    -------
    Operations
        The best direction is found at the second.
    """
    around = Operations(adds=2 * BLOCK, bytes=2 * BLOCK).times(_PARTS * _kernels.DIRECTIONS)
    copied = Operations(adds=1, multiplies=2, bytes=2 + 4).times(2 * _SAMPLES)
    averaged = Operations(adds=1, multiplies=1, bytes=1 + 4).times(_SAMPLES)
    error = Operations(adds=4, multiplies=5, compares=1, bytes=4 + 2 * 8).times(
        _kernels.DIRECTIONS * _SAMPLES
    )
    chosen = Operations(compares=1, bytes=NUM_BANDS * 8).times(_kernels.DIRECTIONS)
    kept = Operations(bytes=NUM_BANDS * 2 * 8).times(2)
    cores = core().times(_PARTS * _kernels.DIRECTIONS)
    return (around + copied + averaged + error + chosen + kept + cores).times(num_intra)


def estimates(work: OneWayWork) -> Operations:
    """Count all estimates of a run.

    Parameters
    ----------
    work : OneWayWork
        What there was to look at.

    Returns
    -------
    Operations
        Of the whole run.
    """
    frames = residual(work.num_blocks) + moved(work.num_moved)
    return frames + intra_noise(work.num_intra) + nearest(work.num_distances)
