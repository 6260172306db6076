"""Delivery: who decides what is sent of the Wyner-Ziv frames, and how it gets to the decoder."""

from dataclasses import dataclass

from dvc.config.fields import check_range

MAX_RATE_MARGIN_PERCENT = 1000


@dataclass(frozen=True)
class ParityBuffer:
    """A file with all planes, of which a decoder takes what it needs."""


@dataclass(frozen=True)
class Live:
    """A decoder asks for what it needs over a feedback channel."""


@dataclass(frozen=True)
class EstimatedRate:
    """No feedback channel: the encoder sends what it estimates that a decoder needs.

    Attributes
    ----------
    rate_margin_percent : int
        What is sent beyond the estimate.
    """

    rate_margin_percent: int = 25

    def __post_init__(self) -> None:
        """Refuse rate margins that make no sense."""
        check_range("rate_margin_percent", self.rate_margin_percent, 0, MAX_RATE_MARGIN_PERCENT)


Delivery = ParityBuffer | Live | EstimatedRate
