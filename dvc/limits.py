"""Limits of the resources that a stream may use, checked from its header, index and size."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dvc.errors import BitstreamError

if TYPE_CHECKING:
    from dvc.config import VideoConfig

MAX_SIDE_PX = 16384
"""Largest side of a picture."""
MAX_TICKS_PER_SECOND = 10**6
"""Finest clock of time stamps."""

MAX_FRAMES = 1_000_000
"""Largest number of frames of a file: nine hours at 30 frames a second."""
MAX_MEMORY_MIB = 8192
"""Largest memory by default: enough for pictures of 3840x2160 pixels in one process."""
MAX_PX_PER_BYTE = 8192
"""Largest number of pixels per byte of a stream."""
BYTES2_PER_PX = 1200
"""Divisor of the square of a stream's bytes, which limits its pixels per byte together with MAX_PX_PER_BYTE.

Frames of 176x144 take a fifth of a second each, so that 600 bytes, which may be seven of them, are decoded in
three seconds. Frames that move have 1 to 100 pixels a byte, identical ones at the coarsest quality 1,000 in
1 kB, and those without any plane, which can be predicted from anything, have 5 bytes.
"""
FREE_PX = 100_000
"""Pixels that any stream may declare: their decoding is quick, and flat pictures have hardly a byte."""
DECODER_BYTES = 250 * 2**20
"""Memory of a decoder process before any picture."""
DECODING_BYTES_PER_PX = 400
"""Memory for each pixel of a frame while it is decoded: planes, priors, geometry."""
REFERENCE_BYTES_PER_PX = 6
"""Memory for each pixel of a frame that waits or serves as reference, in both processes."""


@dataclass(frozen=True)
class Limits:
    """Resources of a decoder; by default the number of frames is limited by the size of the stream."""

    max_frames: int | None = None
    max_memory_mib: int = MAX_MEMORY_MIB

    def check_frames(self, num_frames: int, num_bytes: int, video: "VideoConfig") -> None:
        """Refuse a stream with too many frames for its size."""
        limit = MAX_FRAMES if self.max_frames is None else self.max_frames
        if self.max_frames is None:
            num_px = num_bytes * min(num_bytes**2 // BYTES2_PER_PX, MAX_PX_PER_BYTE)
            limit = min(limit, max(max(num_px, FREE_PX) // (video.width * video.height), 1))
        _check_frames(num_frames, limit, f" of {video.width}x{video.height} in {num_bytes} bytes")

    def check_live_frames(self, num_frames: int) -> None:
        """Refuse more frames than allowed; by default a live encoder may never end."""
        _check_frames(num_frames, num_frames if self.max_frames is None else self.max_frames)

    def check_memory(self, video: "VideoConfig", num_waiting: int, jobs: int) -> None:
        """Refuse pictures that are too large for the number of processes and of waiting frames."""
        per_px = jobs * DECODING_BYTES_PER_PX + num_waiting * REFERENCE_BYTES_PER_PX
        needed_mib = (DECODER_BYTES + video.width * video.height * per_px) >> 20
        if needed_mib > self.max_memory_mib:
            raise BitstreamError(
                f"frames of {video.width}x{video.height}, {num_waiting} at a time in {jobs} processes, may"
                f" take {needed_mib} MiB, more than the {self.max_memory_mib} that are allowed; --max-memory"
                " allows more"
            )


def _check_frames(num_frames: int, limit: int, which: str = "") -> None:
    if num_frames > limit:
        raise BitstreamError(
            f"{num_frames} frames{which}, more than the {limit} that are allowed; --max-frames allows more"
        )
