"""What an encoding run counts: frames, bits, processor time, and the work of the tracker."""

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass

from encoder.corners import CornerDetector
from encoder.tracking import TrackingCounts


@dataclass
class EncoderStatistics:
    """What an encoding run counted.

    Attributes
    ----------
    num_key_frames, num_wyner_ziv_frames : int
        Frames of each type.
    key_cpu_s, wyner_ziv_cpu_s : float
        Processor time spent on the frames of each type, in seconds.
    start_up_cpu_s : float
        Processor time that the first Wyner-Ziv frame took before it was coded again and counted: compiled
        code is loaded when it is first called.
    key_bits, tracks_bits : int
        Bits of all key frames, and of all tracks or points.
    tracking_cpu_s : float
        Processor time spent on corners, tracks and their coding, in seconds.
    num_corners : int
        Corners found.
    num_sad_blocks, num_sad_samples : int
        Blocks compared by the tracker, and samples compared in them.
    num_tracked_frames : int
        Frames that it searched.
    stream_bytes : int
        Size of the stream; 0 in live mode.
    """

    num_key_frames: int = 0
    num_wyner_ziv_frames: int = 0
    key_cpu_s: float = 0.0
    wyner_ziv_cpu_s: float = 0.0
    start_up_cpu_s: float = 0.0
    key_bits: int = 0
    tracks_bits: int = 0
    tracking_cpu_s: float = 0.0
    num_corners: int = 0
    num_sad_blocks: int = 0
    num_sad_samples: int = 0
    num_tracked_frames: int = 0
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

    @contextmanager
    def timing(self, name: str) -> Iterator[None]:
        """Add processor time to one of the fields.

        Parameters
        ----------
        name : str
            The field, as ``key_cpu_s``.

        Yields
        ------
        None
            Nothing; what the block takes is added.
        """
        started = time.process_time()
        yield
        setattr(self, name, getattr(self, name) + time.process_time() - started)

    def add_group(self, num_wyner_ziv: int, key: bytes, tracks: bytes) -> None:
        """Count an encoded group of pictures.

        Parameters
        ----------
        num_wyner_ziv : int
            Its Wyner-Ziv frames.
        key, tracks : bytes
            Its key frame, empty where it has none, and its tracks or points.
        """
        self.num_key_frames += bool(key)
        self.num_wyner_ziv_frames += num_wyner_ziv
        self.key_bits += 8 * len(key)
        self.tracks_bits += 8 * len(tracks)

    def set_tracking(self, tracker: TrackingCounts, detector: CornerDetector, coding_cpu_s: float) -> None:
        """Take over what is counted elsewhere since the start.

        Parameters
        ----------
        tracker : TrackingCounts
            Work of the tracker.
        detector : CornerDetector
            Detector of the corners that are sent as they are.
        coding_cpu_s : float
            Processor time that coding of tracks and points took, in seconds.
        """
        self.tracking_cpu_s = coding_cpu_s + tracker.cpu_s + detector.cpu_s
        self.num_corners = tracker.num_corners + detector.num_corners
        self.num_sad_blocks, self.num_sad_samples = tracker.num_blocks, tracker.num_samples
        self.num_tracked_frames = tracker.num_frames
