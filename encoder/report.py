"""What an encoding run counts: frames, bits, processor time, and the work of the tracker."""

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, astuple, dataclass
from typing import Any

from dvc._jit import loaded_bytes, loading_time_s
from dvc.config import CodecConfig
from dvc.memory import peak_resident_bytes
from dvc.video import Frame
from dvc.wynerziv.buffered import EncodedFrame
from dvc.wynerziv.transform import NUM_BANDS, band_shape
from encoder._kernels import HALF_BLOCK_PX, QUARTER_HALF_BLOCK_PX
from encoder.clock import coding_time_s
from encoder.corners import CornerDetector
from encoder.one_way.operations import estimates
from encoder.one_way.sampled_blocks import OneWayWork
from encoder.operations import Work, stages
from encoder.tracking import TrackingCounts

BLOCK, QUARTER_BLOCK = ((2 * half + 1) ** 2 for half in (HALF_BLOCK_PX, QUARTER_HALF_BLOCK_PX))
"""Samples of a block in images of full size, and of a quarter of it."""

PARTS = (
    "key_cpu_s",
    "tracking_cpu_s",
    "transform_cpu_s",
    "one_way_cpu_s",
    "parity_cpu_s",
    "writing_cpu_s",
)
"""Fields that share the time of coding; the rest of it finds groups of pictures and holds all together."""


def memory_report(baseline_bytes: int) -> dict[str, int]:
    """Say how much memory the encoder took, and how much of it is Python's.

    Parameters
    ----------
    baseline_bytes : int
        What the process held when all was imported and nothing was encoded.

    Returns
    -------
    dict of str to int
        ``peak_bytes`` of the process; ``baseline_bytes``; ``loaded_bytes``, by which loading of compiled code
        made it grow; ``own_bytes``, the rest of the peak. All 0 where the system does not tell.
    """
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
    """What an encoding run counted.

    Attributes
    ----------
    num_key_frames, num_wyner_ziv_frames : int
        Frames of each type.
    coding_cpu_s : float
        Processor time, in seconds, of all that is not reading of the input nor loading of compiled code.
    key_cpu_s : float
        Of it, on key frames.
    tracking_cpu_s : float
        On corners, tracks and their coding.
    transform_cpu_s : float
        On transform, quantiser, bit planes and their check bits.
    one_way_cpu_s : float
        On choosing and packing what is sent where no decoder asks.
    parity_cpu_s : float
        On parity, and on packing what a decoder may ask for or asks for.
    writing_cpu_s : float
        On records and files, or messages.
    reading_cpu_s : float
        Processor time of waiting for frames of the input, beside that of coding.
    start_up_cpu_s : float
        Processor time of loading compiled code, which happens when it is first called, beside that of coding.
    key_bits, tracks_bits : int
        Bits of all key frames, and of all tracks or points.
    num_corners : int
        Corners found.
    num_sad_blocks, num_sad_samples : int
        Blocks compared by the tracker, and samples compared in them.
    num_tracked_frames : int
        Frames that it searched.
    num_pairs : int
        Pairs of points of which one may show the other where to look.
    num_corner_frames : int
        Frames in which corners were looked for.
    num_positions : int
        Positions of tracks that were coded after their first.
    num_planes, num_coded_bands, num_rows : int
        Bit planes of the Wyner-Ziv frames; bands that have some and were coded, and rows of words of 64
        planes of frames with such bands.
    num_sampled_blocks, num_moved_blocks, num_intra_blocks, num_block_points : int
        Blocks that are looked at where no decoder asks: see `encoder.one_way.sampled_blocks.OneWayWork`.
    num_syndrome_sums, num_syndrome_places : int
        Planes times bits of the syndromes that they were added to, and bits of one plane of each block.
    stream_bytes : int
        Size of the stream; 0 in live mode.
    """

    num_key_frames: int = 0
    num_wyner_ziv_frames: int = 0
    coding_cpu_s: float = 0.0
    key_cpu_s: float = 0.0
    tracking_cpu_s: float = 0.0
    transform_cpu_s: float = 0.0
    one_way_cpu_s: float = 0.0
    parity_cpu_s: float = 0.0
    writing_cpu_s: float = 0.0
    reading_cpu_s: float = 0.0
    start_up_cpu_s: float = 0.0
    key_bits: int = 0
    tracks_bits: int = 0
    num_corners: int = 0
    num_sad_blocks: int = 0
    num_sad_samples: int = 0
    num_tracked_frames: int = 0
    num_pairs: int = 0
    num_corner_frames: int = 0
    num_positions: int = 0
    num_planes: int = 0
    num_coded_bands: int = 0
    num_rows: int = 0
    num_sampled_blocks: int = 0
    num_moved_blocks: int = 0
    num_intra_blocks: int = 0
    num_block_points: int = 0
    num_syndrome_sums: int = 0
    num_syndrome_places: int = 0
    stream_bytes: int = 0

    @classmethod
    def total(cls, parts: "Iterable[EncoderStatistics]") -> "EncoderStatistics":
        """Add up what several runs counted.

        Parameters
        ----------
        parts : iterable of EncoderStatistics
            The runs.

        Returns
        -------
        EncoderStatistics
            Sums of all fields.
        """
        return cls(*map(sum, zip(*map(astuple, parts), strict=True)))

    @property
    def num_frames(self) -> int:
        """Frames of both types."""
        return self.num_key_frames + self.num_wyner_ziv_frames

    @property
    def wyner_ziv_cpu_s(self) -> float:
        """Processor time spent on Wyner-Ziv frames, in seconds."""
        return self.transform_cpu_s + self.one_way_cpu_s + self.parity_cpu_s

    @property
    def other_cpu_s(self) -> float:
        """Processor time of coding that is none of its `PARTS`, in seconds."""
        return self.coding_cpu_s - sum(float(getattr(self, name)) for name in PARTS)

    def to_dict(self) -> dict[str, Any]:
        """Return all that was counted.

        Returns
        -------
        dict
            All fields, and the two sums of times.
        """
        sums = {"wyner_ziv_cpu_s": self.wyner_ziv_cpu_s, "other_cpu_s": self.other_cpu_s}
        return asdict(self) | sums

    @contextmanager
    def coding(self) -> Iterator[None]:
        """Count the time of coding and that of loading, but not that of `reading`.

        Yields
        ------
        None
            Nothing; what the block takes is added.
        """
        loaded, read = loading_time_s(), self.reading_cpu_s
        try:
            with self.timing("coding_cpu_s"):
                yield
        finally:
            self.coding_cpu_s -= self.reading_cpu_s - read
            self.start_up_cpu_s += loading_time_s() - loaded

    def reading(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Count the time that frames take to come.

        Parameters
        ----------
        frames : iterable of Frame
            The input.

        Yields
        ------
        Frame
            The same.
        """
        source = iter(frames)
        while True:
            with self.timing("reading_cpu_s"):
                frame = next(source, None)
            if frame is None:
                return
            yield frame

    @contextmanager
    def timing(self, name: str) -> Iterator[None]:
        """Add processor time to one of the fields, without that of loading compiled code.

        Parameters
        ----------
        name : str
            The field, as ``key_cpu_s``.

        Yields
        ------
        None
            Nothing; what the block takes is added.
        """
        started = coding_time_s()
        try:
            yield
        finally:
            setattr(self, name, getattr(self, name) + coding_time_s() - started)

    def add_group(self, frames: Sequence[EncodedFrame], key: bytes, tracks: bytes) -> None:
        """Count an encoded group of pictures.

        Parameters
        ----------
        frames : sequence of EncodedFrame
            Its Wyner-Ziv frames.
        key, tracks : bytes
            Its key frame, empty where it has none, and its tracks or points.
        """
        self.num_key_frames += bool(key)
        self.num_wyner_ziv_frames += len(frames)
        self.key_bits += 8 * len(key)
        self.tracks_bits += 8 * len(tracks)
        for frame in frames:
            self.num_planes += frame.quantization.num_planes
            self.num_coded_bands += sum(map(bool, frame.quantization.planes[: frame.num_packed_bands]))
            self.num_rows += frame.quantization.num_words if frame.num_packed_bands else 0

    def operations_per_pixel(self, config: CodecConfig) -> dict[str, dict[str, float]]:
        """Count operations by the model of `encoder.operations`.

        Parameters
        ----------
        config : CodecConfig
            Configuration of the stream.

        Returns
        -------
        dict of str to dict
            By stage and kind, for each pixel of all frames; key frames are those of x264, and not counted.
        """
        pixels = config.video.width * config.video.height
        places = math.prod(band_shape(config.video.height, config.video.width))
        num_large = (self.num_sad_samples - self.num_sad_blocks * QUARTER_BLOCK) // (BLOCK - QUARTER_BLOCK)
        work = Work(
            num_samples=places * NUM_BANDS * self.num_wyner_ziv_frames,
            num_frames=self.num_wyner_ziv_frames,
            num_coded_bands=self.num_coded_bands,
            num_words=places * self.num_rows,
            num_rows=self.num_rows,
            crc_bits=config.turbo.crc_bits,
            num_blocks=num_large,
            num_quarter_blocks=self.num_sad_blocks - num_large,
            num_pairs=self.num_pairs,
            num_corner_samples=pixels * self.num_corner_frames,
            num_positions=self.num_positions,
            num_syndrome_sums=self.num_syndrome_sums,
            num_syndrome_places=self.num_syndrome_places,
        )
        estimated = OneWayWork(
            self.num_sampled_blocks, self.num_moved_blocks, self.num_intra_blocks, self.num_block_points
        )
        found = {**stages(work), "estimates": estimates(estimated)}
        share = 1.0 / max(pixels * self.num_frames, 1)
        return {name: asdict(stage.times(share)) for name, stage in found.items()}

    def set_one_way(self, work: OneWayWork) -> None:
        """Take over what choosing without a decoder has taken since the start.

        Parameters
        ----------
        work : OneWayWork
            The work.
        """
        self.num_sampled_blocks, self.num_moved_blocks = work.num_blocks, work.num_moved
        self.num_intra_blocks, self.num_block_points = work.num_intra, work.num_distances
        self.num_syndrome_sums = work.num_syndrome_sums
        self.num_syndrome_places = work.num_syndrome_places

    def set_tracking(self, tracker: TrackingCounts, detector: CornerDetector, tracks_cpu_s: float) -> None:
        """Take over what is counted elsewhere since the start.

        Parameters
        ----------
        tracker : TrackingCounts
            Work of the tracker.
        detector : CornerDetector
            Detector of the corners that are sent as they are.
        tracks_cpu_s : float
            Processor time that coding of tracks and points took, in seconds.
        """
        self.tracking_cpu_s = tracks_cpu_s + tracker.cpu_s + detector.cpu_s
        self.num_corners = tracker.num_corners + detector.num_corners
        self.num_sad_blocks, self.num_sad_samples = tracker.num_blocks, tracker.num_samples
        self.num_tracked_frames, self.num_pairs = tracker.num_frames, tracker.num_pairs
        self.num_corner_frames = tracker.num_starts
