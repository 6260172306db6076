"""Delivery: who decides what is sent of the Wyner-Ziv frames, and how it gets to the decoder."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ParityBuffer:
    """A file with all planes, of which a decoder takes what it needs."""


@dataclass(frozen=True)
class Live:
    """A decoder asks for what it needs over a feedback channel."""


@dataclass(frozen=True)
class NoFeedback:
    """No feedback channel: nothing is sent of Wyner-Ziv frames, of which there are fewer."""


Delivery = ParityBuffer | Live | NoFeedback
"""One of the three."""
