"""Operations of the stages of encoding, independent of the processor.

The model counts operations of kernels on samples, coefficients, words and other data one by one, as the code
has them; a processor does many at once in vectors. Loops, addresses and conversions between types do not
count. Bytes are those of all elements of arrays that are read or written, in a cache or not.
"""

import time
from collections.abc import Mapping
from dataclasses import astuple, dataclass

import numpy as np

from dvc._jit import loading_time_s
from dvc.tracks import PointTracks
from dvc.tracks.regression.regression_coding import NUM_FEATURES, NUM_NEIGHBOURS, ROW_FEATURES
from dvc.wynerziv.transform import BLOCK, NUM_BANDS
from encoder._kernels import HALF_BLOCK_PX, NUM_NEAREST, QUARTER_HALF_BLOCK_PX, SAMPLED_PX

LARGE_SAMPLES, SMALL_SAMPLES = ((2 * half + 1) ** 2 for half in (HALF_BLOCK_PX, QUARTER_HALF_BLOCK_PX))
"""Samples of a block in images of full size, and of a quarter of it."""
_VECTOR_PX = 8
"""Samples of a row of a block that are compared at once."""


def coding_time_s() -> float:
    """Return the processor time of this thread, without the loading of compiled code."""
    return time.thread_time() - loading_time_s()


@dataclass
class TrackingWork:
    """Work of the tracker: counts of its operations, and processor time."""

    num_corners: int = 0  # detected points
    num_blocks: int = 0  # SADs of blocks, and the samples in them
    num_samples: int = 0
    num_frames: int = 0  # frames that were searched
    num_starts: int = 0  # frames with points that were detected for tracking
    num_pairs: int = 0  # pairs of points, one a possible spatial motion candidate of the other
    num_positions: int = 0  # coded positions of tracks, without the first of each track
    num_interpolated: int = 0  # blocks compared with their prediction by tracks, and pairs with nearby points
    num_near: int = 0
    cpu_s: float = 0.0  # processor time of tracking and of coding tracks or points, in seconds


@dataclass(frozen=True)
class Operations:
    """Operations of a stage."""

    adds: float = 0  # sums and differences
    multiplies: float = 0  # products, quotients and remainders
    logic: float = 0  # AND, OR, XOR and shifts of words
    compares: float = 0  # comparisons, minima, maxima and magnitudes
    bytes: float = 0  # read from arrays and written to them

    def __add__(self, other: "Operations") -> "Operations":
        """Return the sum."""
        return Operations(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    def times(self, factor: float) -> "Operations":
        """Return the operations of several times the work."""
        return Operations(*(factor * number for number in astuple(self)))

    @property
    def total(self) -> float:
        """Operations of all kinds; bytes are none."""
        return self.adds + self.multiplies + self.logic + self.compares


def butterfly() -> Operations:
    """Count one dimension of the 4x4 transform, for four samples ([Malvar2003]: doubling is a sum, too)."""
    return Operations(adds=8 + 2, bytes=2 * BLOCK * 2)


def transform(num_samples: float, num_frames: float) -> Operations:
    """Count the transform of frames, and the search for the extremes of each band."""
    unpacking = Operations(logic=6, bytes=BLOCK * (1 + 2)).times(num_samples / BLOCK)
    both = butterfly().times(2 * num_samples / BLOCK)
    extremes = Operations(compares=2, bytes=2 * 2).times(num_samples)
    return unpacking + both + extremes + Operations(bytes=3 * 2).times(NUM_BANDS * num_frames)


def quantisation(num_coefficients: float) -> Operations:
    """Count embedded bins of coefficients, and packing of their numbers into words of planes."""
    bins = Operations(multiplies=1, adds=1, compares=2, bytes=2 + 4)
    words = Operations(logic=2, bytes=4 + 8 + 8)
    return (bins + words).times(num_coefficients)


def block_comparison(half_side_px: int = HALF_BLOCK_PX) -> Operations:
    """Count the sum of absolute differences of a block, in vectors that overlap in the middle of each row."""
    rows = 2 * half_side_px + 1
    pair = Operations(adds=2 * 2, compares=2, logic=2, bytes=4)
    return pair.times(_VECTOR_PX * rows)


def spatial_candidates() -> Operations:
    """Count the offer of the motion of a matched point to another one."""
    return Operations(adds=2 + 1 + 1, multiplies=2, logic=1, compares=1, bytes=4 * 4 + 2 * 8)


def corners(num_samples: float) -> Operations:
    """Count the response to corners of frames, at half the resolution."""
    shrinking = Operations(adds=4, logic=1, bytes=4 + 1)
    smooth = Operations(adds=2, logic=1, bytes=3 + 2)
    slope = Operations(adds=1, bytes=2 * 2 + 4)
    gradients = (smooth + slope).times(2)
    products = Operations(multiplies=3, bytes=6 * 4 + 3 * 4)
    window = Operations(adds=2, bytes=3 * 4 + 4).times(3 * 2)
    response = Operations(adds=3, multiplies=4, bytes=3 * 4 + 4)
    return (shrinking + gradients + products + window + response).times(num_samples / 4)


def fit() -> Operations:
    """Count the position of a track by the fitted motion."""
    both = Operations(multiplies=2, adds=2, bytes=3 * 8)
    return both.times(NUM_FEATURES) + Operations(bytes=2 * 8)


def predicted_positions(tracks: PointTracks) -> int:
    """Count the positions that are predicted when tracks are coded."""
    forward, backward = (np.isfinite(one[:, :, 0]) for one in (tracks.forward, tracks.backward))
    count = int(forward[:, 1:].sum())
    if len(backward):
        count += int(backward[:, :-1].sum()) + int(forward[forward[:, -1], :-1].sum())
    return count


def regression(num_positions: float) -> Operations:
    """Count the prediction of positions by recursive least squares, and the update after each."""
    products = Operations(multiplies=1, adds=1, bytes=2 * 8)
    gain = products.times((ROW_FEATURES + 1) * NUM_FEATURES) + Operations(compares=1, bytes=8 * ROW_FEATURES)
    bounded = Operations(multiplies=2, compares=1, bytes=3 * 8).times(NUM_FEATURES)
    limited = Operations(multiplies=1, adds=1, compares=2, bytes=2 * 8).times(2)
    coefficients = (Operations(multiplies=1, bytes=8) + limited).times(NUM_FEATURES)
    covariance = Operations(multiplies=2, adds=1, bytes=4 * 8).times(ROW_FEATURES * NUM_FEATURES)
    neighbours = (fit() + Operations(adds=6, multiplies=3, bytes=33)).times(NUM_NEIGHBOURS)
    features = Operations(adds=4, multiplies=7, bytes=7 * 8 + 3 * 7 * 8)
    prediction = Operations(adds=9, multiplies=7, compares=4, bytes=12 * 8)
    learning = Operations(adds=11, multiplies=11, compares=6, bytes=13 * 8 + 1)
    once = gain + bounded + coefficients + covariance + neighbours + fit() + features + prediction + learning
    return once.times(num_positions)


def interpolation(num_blocks: float, num_near: float) -> Operations:
    """Count the prediction of sampled blocks by tracks, and the search for the nearest points."""
    bilinear = Operations(adds=10, multiplies=6, compares=4, bytes=4 + 2 * 8)
    sample = bilinear.times(2) + Operations(adds=3, multiplies=2, bytes=1)
    weighed = Operations(adds=10, multiplies=5, compares=1, bytes=26 * 8).times(NUM_NEAREST)
    block = sample.times(SAMPLED_PX**2) + weighed + Operations(multiplies=4, compares=1, bytes=12 * 8)
    near = Operations(adds=3, multiplies=2, compares=NUM_NEAREST, bytes=(2 + NUM_NEAREST) * 8)
    return block.times(num_blocks) + near.times(num_near)


def stages(
    tracking: TrackingWork, frame_px: int, frame_samples: int, num_frames: int, num_coded_bands: int
) -> Mapping[str, Operations]:
    """Count the operations of the stages that belong to the encoder.

    `frame_samples` is the size of a frame in whole 4x4 blocks; `num_frames` were transformed, and
    `num_coded_bands` of their bands have planes.
    """
    num_large = (tracking.num_samples - tracking.num_blocks * SMALL_SAMPLES) // (
        LARGE_SAMPLES - SMALL_SAMPLES
    )
    num_small = tracking.num_blocks - num_large
    compared = block_comparison().times(num_large)
    compared += block_comparison(QUARTER_HALF_BLOCK_PX).times(num_small)
    return {
        "transform": transform(frame_samples * num_frames, num_frames),
        "quantiser and planes": quantisation(frame_samples / NUM_BANDS * num_coded_bands),
        "corners": corners(frame_px * tracking.num_starts),
        "block matching": compared + spatial_candidates().times(tracking.num_pairs),
        "coding of tracks": regression(tracking.num_positions),
        "interpolation": interpolation(tracking.num_interpolated, tracking.num_near),
    }
