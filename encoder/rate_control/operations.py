"""What choosing without a decoder takes in operations: a model of the blocks that are looked at."""

from dvc.wynerziv.transform import BLOCK, NUM_BANDS
from encoder.operations import Operations
from encoder.rate_control import _kernels
from encoder.rate_control.sampled_blocks import BLOCK_PX, RateControlWork

_SAMPLES = BLOCK_PX * BLOCK_PX
_PARTS = _SAMPLES // (BLOCK * BLOCK)


def nearest(num_distances: float) -> Operations:
    """Count which points are nearest to blocks."""
    place = Operations(compares=2, bytes=2 * 4).times(_kernels.NEAREST)
    return (Operations(adds=1, bytes=4) + place).times(num_distances)


def moved(num_moved: float) -> Operations:
    """Count where blocks come from in a reference, at half samples, and the noise there."""
    point = Operations(adds=9, multiplies=5, logic=1, compares=1, bytes=4 + 4 * 8)
    motion = point.times(_kernels.NEAREST) + Operations(adds=2, multiplies=4, compares=1, bytes=4 * 8)
    place = Operations(adds=3, logic=3, compares=4, bytes=2 * 8)
    lines = Operations(adds=3, logic=3, bytes=2 * 4 * 8).times(BLOCK_PX)
    samples = Operations(adds=4, bytes=4 + 2 * 2).times(_SAMPLES)
    origin = Operations(adds=5, multiplies=3, logic=2, compares=4, bytes=3 * 8)
    noise = Operations(adds=1, multiplies=1, bytes=8 + 3 * 4).times(NUM_BANDS)
    return (motion + place + lines + samples + origin + noise).times(num_moved)


def core() -> Operations:
    """Count the 4x4 transform of a part of a block."""
    line = Operations(adds=4 * 2, multiplies=2, bytes=BLOCK * 4)
    return (line + Operations(bytes=BLOCK)).times(BLOCK) + (line + Operations(bytes=4 * BLOCK)).times(BLOCK)


def residual(num_blocks: float) -> Operations:
    """Count the residual of blocks, its energy by bands, and where it stands in the tables of needs."""
    cut = Operations(bytes=2 * 8).times(BLOCK_PX) + Operations(multiplies=1, bytes=1 + 2).times(_SAMPLES)
    columns = Operations(adds=10, bytes=2 * BLOCK * 2).times(_SAMPLES / BLOCK)
    rows = Operations(adds=10, bytes=BLOCK * 2).times(_SAMPLES / BLOCK)
    squares = Operations(adds=1, multiplies=1, bytes=2 * 4).times(_SAMPLES)
    means = Operations(adds=1, multiplies=1, bytes=5 * 4).times(NUM_BANDS)
    place = Operations(multiplies=3, adds=2 + 1 + 1, logic=1, compares=2, bytes=2 * 4 + 2 * 4 + 2 + 2 * 8)
    left = Operations(multiplies=3, adds=1, compares=1, bytes=2 + 2 * 8 + 4)
    bands = (place + left).times(NUM_BANDS)
    return (cut + columns + rows + squares + means + bands).times(num_blocks)


def intra_noise(num_intra: float) -> Operations:
    """Count what quantisation leaves of blocks of key frames, predicted in the best of three directions."""
    directions, edge = _kernels.DIRECTIONS, 2 * BLOCK - 1
    lines = (
        Operations(adds=4 * 2, multiplies=2, bytes=4 + 4 * 4).times(2) + Operations(adds=1, bytes=2 * 4)
    ).times(_PARTS)
    whole = Operations(multiplies=1, bytes=4 + 8).times(_SAMPLES)
    predicted = Operations(multiplies=2, bytes=4 + 8).times(2 * _SAMPLES / BLOCK) + Operations(
        multiplies=2, bytes=8
    ).times(_PARTS)
    size = Operations(adds=2, compares=1, bytes=4 * 8).times(directions * _PARTS * edge)
    chosen = Operations(compares=1, bytes=2 * 8).times(directions - 1)
    error = Operations(adds=4, multiplies=3, compares=1, bytes=2 * 8).times(_SAMPLES)
    mean = Operations(multiplies=1, bytes=8).times(NUM_BANDS)
    parts = core().times(_PARTS) + lines + whole + predicted
    return (parts + size + chosen + error + mean).times(num_intra)


def estimates(work: RateControlWork) -> Operations:
    """Count all estimates of a run."""
    frames = residual(work.num_blocks) + moved(work.num_moved)
    return frames + intra_noise(work.num_intra) + nearest(work.num_distances)
