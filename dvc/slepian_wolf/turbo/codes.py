"""Turbo codes: two recursive convolutional codes in parallel, of which parity alone is sent."""

from dataclasses import dataclass

from dvc.slepian_wolf.turbo.trellis import memory


@dataclass(frozen=True)
class TurboCode:
    """A rate-compatible turbo code for the parity of bit planes of any length."""

    feedback: int  # polynomial in D, bit i is the coefficient of D^i
    feedforward: int
    period: int  # puncturing period of both parity streams

    def __post_init__(self) -> None:
        memory(self.feedback, self.feedforward)
        if self.period < 1:
            raise ValueError(f"`period` must be at least 1, got {self.period}")


CLASSICAL = TurboCode(0b11001, 0b11011, 48)
"""(1 + D + D^3 + D^4) / (1 + D^3 + D^4), twice, and the puncturing period of [Artigas2007]."""
