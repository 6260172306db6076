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
from encoder.work import TrackingWork, coding_time_s, stages

TIMED_PARTS = ("key_cpu_s", "transform_cpu_s", "parity_cpu_s", "writing_cpu_s")
"""Fields with parts of the time of coding, besides tracking; the rest forms groups of pictures."""


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
        height, width = config.video.height, config.video.width
        frame_samples = math.prod(band_shape(height, width)) * NUM_BANDS
        work = stages(
            self.tracking, width * height, frame_samples, self.num_transformed, self.num_coded_bands
        )
        share = 1.0 / max(width * height * self.num_frames, 1)
        return {name: asdict(stage.times(share)) for name, stage in work.items()}


def _added(parts: Sequence[Any]) -> Any:
    """Add up records of numbers and of further records."""
    first: Any = parts[0]
    if not is_dataclass(first):
        return sum(parts)
    columns = ([getattr(part, entry.name) for part in parts] for entry in fields(first))
    return first.__class__(*map(_added, columns))
