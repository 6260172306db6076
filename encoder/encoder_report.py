"""Statistics of an encoding run: frames, bits, processor time, and operations independent of the processor.

The model counts operations of kernels on samples, coefficients, words and other data one by one, as the code
has them; a processor does many at once in vectors. Loops, addresses and conversions between types do not
count. Bytes are those of all elements of arrays that are read or written, in a cache or not.
"""

import math
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, astuple, dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc._jit import loaded_bytes, loading_time_s
from dvc.config import CodecConfig
from dvc.memory import peak_resident_bytes
from dvc.stream import GopRecord
from dvc.tracks import PointTracks
from dvc.tracks.regression.regression_coding import NUM_FEATURES, NUM_NEIGHBOURS, ROW_FEATURES
from dvc.video import Frame
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.transform import BLOCK, NUM_BANDS, band_shape
from encoder._kernels import HALF_BLOCK_PX, NUM_NEAREST, QUARTER_HALF_BLOCK_PX, SAMPLED_PX

TIMED_PARTS = ("key_cpu_s", "transform_cpu_s", "parity_cpu_s", "writing_cpu_s")
"""Fields with parts of the time of coding, besides tracking; the rest forms groups of pictures."""
LARGE_SAMPLES, SMALL_SAMPLES = ((2 * half + 1) ** 2 for half in (HALF_BLOCK_PX, QUARTER_HALF_BLOCK_PX))
"""Samples of a block in images of full size, and of a quarter of it."""


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

    def add_blocks(self, counts: NDArray[np.int64]) -> None:
        """Add numbers of blocks and samples."""
        num_blocks, num_samples = counts.tolist()
        self.num_blocks += num_blocks
        self.num_samples += num_samples


def memory_report(baseline_bytes: int) -> dict[str, int]:
    """Return the peak memory of the encoder, and the shares of Python and of compiled code."""
    peak, loaded = peak_resident_bytes(), loaded_bytes()
    sizes = {"peak_bytes": peak, "baseline_bytes": baseline_bytes, "loaded_bytes": loaded}
    return {**sizes, "own_bytes": max(peak - baseline_bytes - loaded, 0)}


@dataclass
class EncoderStatistics:
    """Statistics of an encoding run."""

    num_key_frames: int = 0  # frames of each type
    num_wyner_ziv_frames: int = 0
    # processor times in seconds, without reading the input and loading compiled code
    coding_cpu_s: float = 0.0
    key_cpu_s: float = 0.0  # part of it for key frames
    transform_cpu_s: float = 0.0  # part for transform, quantiser and bit planes
    parity_cpu_s: float = 0.0  # part for parity and answers, or for packing planes
    writing_cpu_s: float = 0.0  # part for records and files, or messages
    reading_cpu_s: float = 0.0  # reading of the input, besides coding
    start_up_cpu_s: float = 0.0  # loading of compiled code at its first calls, besides coding
    key_bits: int = 0  # bits of all key frames, and of all tracks or points
    tracks_bits: int = 0
    num_transformed: int = 0  # Wyner-Ziv frames with bit planes; their planes and coded bands
    num_planes: int = 0
    num_coded_bands: int = 0
    stream_bytes: int = 0  # size of the stream; 0 in live mode
    tracking: TrackingWork = field(default_factory=TrackingWork)

    @property
    def num_frames(self) -> int:
        """Frames of both types."""
        return self.num_key_frames + self.num_wyner_ziv_frames

    def to_dict(self) -> dict[str, Any]:
        """Return all statistics, JSON-safe; the rest of the time of coding is `other_cpu_s`."""
        parts = self.tracking.cpu_s + sum(float(getattr(self, name)) for name in TIMED_PARTS)
        sums = {"wyner_ziv_cpu_s": self.transform_cpu_s + self.parity_cpu_s}
        return asdict(self) | sums | {"other_cpu_s": self.coding_cpu_s - parts}

    @contextmanager
    def coding(self) -> Iterator[None]:
        """Measure the time of coding and of loading, without that of `reading`."""
        loaded, read = loading_time_s(), self.reading_cpu_s
        try:
            with self.timing("coding_cpu_s"):
                yield
        finally:
            self.coding_cpu_s -= self.reading_cpu_s - read
            self.start_up_cpu_s += loading_time_s() - loaded

    def reading(self, frames: Iterable[Frame | None]) -> Iterator[Frame | None]:
        """Yield frames and measure the time of reading them."""
        source = iter(frames)
        while True:
            started = coding_time_s()
            try:
                frame = next(source)
            except StopIteration:
                return
            finally:
                self.reading_cpu_s += coding_time_s() - started
            yield frame

    @contextmanager
    def timing(self, name: str) -> Iterator[None]:
        """Add processor time to a field, without the loading of compiled code."""
        started = coding_time_s()
        try:
            yield
        finally:
            setattr(self, name, getattr(self, name) + coding_time_s() - started)

    def add_group(self, frames: Sequence[EncodedFrame], record: GopRecord) -> None:
        """Count an encoded group of pictures."""
        self.num_key_frames += 1
        self.num_wyner_ziv_frames += record.num_frames - 1
        self.key_bits += 8 * len(record.key)
        self.tracks_bits += 8 * len(record.tracks)
        self.num_transformed += len(frames)
        for frame in frames:
            self.num_planes += frame.quantization.num_planes
            self.num_coded_bands += len(frame.quantization.bands)

    def operations_per_pixel(self, config: CodecConfig) -> dict[str, dict[str, float]]:
        """Count the operations of each stage by the model of this module."""
        height, width = config.video.height, config.video.width
        num_samples = math.prod(band_shape(height, width)) * NUM_BANDS  # samples of a frame in whole blocks
        work = self.tracking
        num_large = work.num_samples - work.num_blocks * SMALL_SAMPLES
        num_large //= LARGE_SAMPLES - SMALL_SAMPLES
        compared = block_comparison().times(num_large)
        compared += block_comparison(QUARTER_HALF_BLOCK_PX).times(work.num_blocks - num_large)
        stages = {
            "transform": transform(num_samples * self.num_transformed, self.num_transformed),
            "quantiser and planes": quantisation(num_samples / NUM_BANDS * self.num_coded_bands),
            "corners": corners(width * height * work.num_starts),
            "block matching": compared + SPATIAL_CANDIDATES.times(work.num_pairs),
            "coding of tracks": regression(work.num_positions),
            "interpolation": interpolation(work.num_interpolated, work.num_near),
        }
        share = 1.0 / max(width * height * self.num_frames, 1)
        return {name: asdict(stage.times(share)) for name, stage in stages.items()}


def added_up(parts: Sequence[Any]) -> Any:
    """Add up records of numbers and of further records."""
    first: Any = parts[0]
    if not is_dataclass(first):
        return sum(parts)
    columns = ([getattr(part, entry.name) for part in parts] for entry in fields(first))
    return first.__class__(*map(added_up, columns))


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


def transform(num_samples: float, num_frames: float) -> Operations:
    """Count the transform of frames, and the search for the extremes of each band."""
    unpacking = Operations(logic=6, bytes=BLOCK * (1 + 2)).times(num_samples / BLOCK)
    # one dimension for four samples ([Malvar2003]: doubling is a sum, too), twice
    both = Operations(adds=8 + 2, bytes=2 * BLOCK * 2).times(2 * num_samples / BLOCK)
    extremes = Operations(compares=2, bytes=2 * 2).times(num_samples)
    return unpacking + both + extremes + Operations(bytes=3 * 2).times(NUM_BANDS * num_frames)


def quantisation(num_coefficients: float) -> Operations:
    """Count embedded bins of coefficients, and packing of their numbers into words of planes."""
    bins = Operations(multiplies=1, adds=1, compares=2, bytes=2 + 4)
    words = Operations(logic=2, bytes=4 + 8 + 8)
    return (bins + words).times(num_coefficients)


def block_comparison(half_side_px: int = HALF_BLOCK_PX) -> Operations:
    """Count the SAD of a block, in vectors of 8 samples that overlap in the middle of each row."""
    rows = 2 * half_side_px + 1
    pair = Operations(adds=2 * 2, compares=2, logic=2, bytes=4)
    return pair.times(8 * rows)


SPATIAL_CANDIDATES = Operations(adds=2 + 1 + 1, multiplies=2, logic=1, compares=1, bytes=4 * 4 + 2 * 8)
"""Offer of the motion of a matched point to another one."""


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
    fit = Operations(multiplies=2, adds=2, bytes=3 * 8).times(NUM_FEATURES) + Operations(bytes=2 * 8)
    neighbours = (fit + Operations(adds=6, multiplies=3, bytes=33)).times(NUM_NEIGHBOURS)
    features = Operations(adds=4, multiplies=7, bytes=7 * 8 + 3 * 7 * 8)
    prediction = Operations(adds=9, multiplies=7, compares=4, bytes=12 * 8)
    learning = Operations(adds=11, multiplies=11, compares=6, bytes=13 * 8 + 1)
    once = gain + bounded + coefficients + covariance + neighbours + fit + features + prediction + learning
    return once.times(num_positions)


def interpolation(num_blocks: float, num_near: float) -> Operations:
    """Count the prediction of sampled blocks by tracks, and the search for the nearest points."""
    bilinear = Operations(adds=10, multiplies=6, compares=4, bytes=4 + 2 * 8)
    sample = bilinear.times(2) + Operations(adds=3, multiplies=2, bytes=1)
    weighed = Operations(adds=10, multiplies=5, compares=1, bytes=26 * 8).times(NUM_NEAREST)
    block = sample.times(SAMPLED_PX**2) + weighed + Operations(multiplies=4, compares=1, bytes=12 * 8)
    near = Operations(adds=3, multiplies=2, compares=NUM_NEAREST, bytes=(2 + NUM_NEAREST) * 8)
    return block.times(num_blocks) + near.times(num_near)
