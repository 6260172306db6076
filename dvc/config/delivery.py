"""Delivery: who decides what is sent of the Wyner-Ziv frames, and how it gets to the decoder."""

from dataclasses import dataclass
from typing import ClassVar

from dvc.config.fields import check_range

MAX_RATE_MARGIN_PERCENT = 1000


@dataclass(frozen=True)
class ParityBuffer:
    """A file with all planes, of which a decoder takes what it needs."""

    intra_period: ClassVar[int] = 96
    """Most frames between key frames: what is lost is back, and players may start, after three seconds."""
    long_term_groups: ClassVar[int] = 64
    """Groups that long-term references are looked for in."""


@dataclass(frozen=True)
class Live:
    """A decoder asks for what it needs over a feedback channel."""

    intra_period: ClassVar[int] = ParityBuffer.intra_period
    long_term_groups: ClassVar[int] = ParityBuffer.long_term_groups


@dataclass(frozen=True)
class EstimatedRate:
    """No feedback channel: the encoder sends what it estimates that a decoder needs.

    Attributes
    ----------
    rate_margin_percent : int
        What is sent beyond the estimate.
    """

    rate_margin_percent: int = 25
    intra_period: ClassVar[int] = 16
    """Shorter: P-type frames that rest on P-type frames need more than can be estimated."""
    long_term_groups: ClassVar[int] = 0

    def __post_init__(self) -> None:
        """Refuse rate margins that make no sense."""
        check_range("rate_margin_percent", self.rate_margin_percent, 0, MAX_RATE_MARGIN_PERCENT)


Delivery = ParityBuffer | Live | EstimatedRate
