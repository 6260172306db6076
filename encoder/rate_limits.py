"""Limits of the bitrate of a stream, and of its frames."""

from dataclasses import dataclass

from dvc.config.sections import check_range

WINDOW_S = 2.0
TOLERANCE = 0.05
"""Relative error of the bitrate that groups of `WINDOW_S` may have."""
MAX_BITS = 10**12


@dataclass(frozen=True)
class RateLimits:
    """Limits of a stream, at least one of them."""

    bits_per_s: int | None = None  # mean over `WINDOW_S`; None: constant quality
    bits_per_frame: int | None = None  # largest key frame, and largest mean of the frames between two

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name in ("bits_per_s", "bits_per_frame"):
            if getattr(self, name) is not None:
                check_range(name, getattr(self, name), 1, MAX_BITS)
