"""Statistics of an encoding run: frames, bits, processor time, and work of the tracker."""

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from typing import Any

from dvc._jit import loaded_bytes, loading_time_s
from dvc.config import CodecConfig
from dvc.memory import peak_resident_bytes
from dvc.stream import GopRecord
from dvc.video import Frame
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.transform import NUM_BANDS, band_shape
from encoder._kernels import HALF_BLOCK_PX, QUARTER_HALF_BLOCK_PX
from encoder.work import TrackingWork, Workload, coding_time_s, stages

BLOCK, QUARTER_BLOCK = ((2 * half + 1) ** 2 for half in (HALF_BLOCK_PX, QUARTER_HALF_BLOCK_PX))
"""Samples of a block in images of full size, and of a quarter of it."""

TIMED_PARTS = ("key_cpu_s", "transform_cpu_s", "parity_cpu_s", "writing_cpu_s")
"""Fields with parts of the time of coding, besides tracking; the rest forms groups of pictures."""


def memory_report(baseline_bytes: int) -> dict[str, int]:
    """Return the peak memory of the encoder, and the shares of Python and of compiled code."""
    peak, loaded = peak_resident_bytes(), loaded_bytes()
    own = max(peak - baseline_bytes - loaded, 0)
    return {
        "peak_bytes": peak,
        "baseline_bytes": baseline_bytes,
        "loaded_bytes": loaded,
        "own_bytes": own,
    }


@dataclass
class EncoderStatistics:
    """Statistics of an encoding run."""

    num_key_frames: int = 0  # frames of each type
    num_wyner_ziv_frames: int = 0
    # processor times in seconds, without reading of the input and loading of compiled code
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

    @classmethod
    def total(cls, parts: "Iterable[EncoderStatistics]") -> "EncoderStatistics":
        """Add up the statistics of several runs."""
        total: EncoderStatistics = _added(list(parts))
        return total

    @property
    def num_frames(self) -> int:
        """Frames of both types."""
        return self.num_key_frames + self.num_wyner_ziv_frames

    @property
    def wyner_ziv_cpu_s(self) -> float:
        """Processor time spent on Wyner-Ziv frames, in seconds."""
        return self.transform_cpu_s + self.parity_cpu_s

    @property
    def other_cpu_s(self) -> float:
        """Processor time of coding that is neither tracking nor one of `TIMED_PARTS`, in seconds."""
        parts = (float(getattr(self, name)) for name in TIMED_PARTS)
        return self.coding_cpu_s - self.tracking.cpu_s - sum(parts)

    def to_dict(self) -> dict[str, Any]:
        """Return all statistics, JSON-safe."""
        sums = {"wyner_ziv_cpu_s": self.wyner_ziv_cpu_s, "other_cpu_s": self.other_cpu_s}
        return asdict(self) | sums

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
        """Count operations by the model of `encoder.work`."""
        pixels = config.video.width * config.video.height
        positions = math.prod(band_shape(config.video.height, config.video.width))
        tracking = self.tracking
        num_large = (tracking.num_samples - tracking.num_blocks * QUARTER_BLOCK) // (BLOCK - QUARTER_BLOCK)
        work = Workload(
            num_samples=positions * NUM_BANDS * self.num_transformed,
            num_frames=self.num_transformed,
            num_coded_bands=self.num_coded_bands,
            num_blocks=num_large,
            num_quarter_blocks=tracking.num_blocks - num_large,
            num_pairs=tracking.num_pairs,
            num_corner_samples=pixels * tracking.num_starts,
            num_positions=tracking.num_positions,
            num_interpolated=tracking.num_interpolated,
            num_near=tracking.num_near,
        )
        share = 1.0 / max(pixels * self.num_frames, 1)
        return {name: asdict(stage.times(share)) for name, stage in stages(work).items()}


def _added(parts: Sequence[Any]) -> Any:
    """Add up records of numbers and of further records."""
    first: Any = parts[0]
    if not is_dataclass(first):
        return sum(parts)
    columns = ([getattr(part, entry.name) for part in parts] for entry in fields(first))
    return first.__class__(*map(_added, columns))
