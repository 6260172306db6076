"""What a stream may take."""

from dataclasses import dataclass

from dvc.config.fields import check_range

WINDOW_S = 2.0
TOLERANCE = 0.05
"""Of a bitrate, by which groups that last so long may be off."""
MAX_BITS = 10**12


@dataclass(frozen=True)
class RateLimits:
    """What a stream may take."""

    bits_per_s: int | None = None  # on the mean over `WINDOW_S`; None: quality is constant
    bits_per_frame: int | None = None  # most of a key frame, and of the others on the mean

    @property
    def is_none(self) -> bool:
        """Whether nothing is limited."""
        return self.bits_per_s is None and self.bits_per_frame is None

    def __post_init__(self) -> None:
        """Refuse limits that make no sense."""
        for name in ("bits_per_s", "bits_per_frame"):
            if getattr(self, name) is not None:
                check_range(name, getattr(self, name), 1, MAX_BITS)
