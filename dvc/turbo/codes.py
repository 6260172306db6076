"""Descriptions of turbo codes, the presets, and the choice of a code by entropy."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from dvc.turbo.trellis import memory

Layout = Literal["joined", "parallel"]


@dataclass(frozen=True)
class TurboCode:
    """A rate-compatible turbo code for the parity of bit planes of any length."""

    name: str
    feedback: int  # polynomial in D, bit i is the coefficient of D^i
    feedforward: int
    copies: tuple[
        tuple[float, int], ...
    ]  # (fraction of the bits, times that each of them enters the trellis)
    layout: Layout = "joined"  # one long trellis over all copies, or one trellis per copy ("parallel")
    period: int = 0  # parallel: puncturing period of every parity stream; 0: no period
    grid_rate: float = 0.0  # joined: rate at which the released parity is evenly spaced; 0: no such rate
    spread: int = 0  # joined: trellis steps within which no two bits with few copies meet twice
    max_entropy: float = 1.0  # largest mean prior entropy, in bits per bit, that the code is meant for

    def __post_init__(self) -> None:
        memory(self.feedback, self.feedforward)
        if not self.copies or any(not 0 < fraction <= 1 or times < 1 for fraction, times in self.copies):
            raise ValueError(f"`copies` must hold (fraction in (0, 1], times >= 1), got {self.copies}")
        if abs(sum(fraction for fraction, _ in self.copies) - 1) > 1e-6:
            raise ValueError(f"fractions of `copies` must add up to 1, got {self.copies}")
        if self.layout == "parallel" and (len(self.copies) != 1 or self.period < 1):
            raise ValueError("a parallel code has one copy count for all bits and a puncturing period >= 1")
        if self.layout not in ("joined", "parallel") or not 0 <= self.grid_rate <= 1:
            raise ValueError(f"`layout` or `grid_rate` out of range: {self.layout}, {self.grid_rate}")

    @property
    def mean_copies(self) -> float:
        """Trellis steps per bit of the plane."""
        return sum(fraction * times for fraction, times in self.copies)

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON-safe values.

        Returns
        -------
        dict
            One entry per field.
        """
        fields = asdict(self)
        fields["copies"] = [list(pair) for pair in self.copies]
        return fields

    @classmethod
    def from_dict(cls, fields: dict[str, Any]) -> "TurboCode":
        """Rebuild a code from what `to_dict` returned.

        Parameters
        ----------
        fields : dict
            One entry per field.

        Returns
        -------
        TurboCode
            The same code.
        """
        copies = tuple((float(fraction), int(times)) for fraction, times in fields["copies"])
        return cls(**{**fields, "copies": copies})


CLASSICAL = TurboCode("classical", 0b11001, 0b11011, ((1.0, 2),), layout="parallel", period=48)

ADAPTIVE = (
    TurboCode("joined-16", 0b11001, 0b11011, ((1.0, 2),), max_entropy=0.25),
    TurboCode("irregular-8", 0b1101, 0b1011, ((0.95, 2), (0.05, 8)), max_entropy=0.42),
    TurboCode("irregular-4a", 0b111, 0b101, ((0.9, 2), (0.1, 6)), max_entropy=0.62),
    TurboCode("irregular-4b", 0b111, 0b101, ((0.9, 2), (0.1, 10)), max_entropy=1.0),
)

_FAMILIES = {"classical": (CLASSICAL,), "adaptive": ADAPTIVE}


def family(name: str = "adaptive") -> tuple[TurboCode, ...]:
    """Return the codes of a family, in order of the entropy that they are meant for.

    Parameters
    ----------
    name : str
        ``"adaptive"`` or ``"classical"``.

    Returns
    -------
    tuple of TurboCode
        One code or more.

    Raises
    ------
    ValueError
        If there is no such family.
    """
    if name not in _FAMILIES:
        raise ValueError(f"`name` must be one of {sorted(_FAMILIES)}, got {name!r}")
    return _FAMILIES[name]


def choose_code(codes: Sequence[TurboCode], entropy: float) -> int:
    """Pick the code of a family for a plane.

    Parameters
    ----------
    codes : sequence of TurboCode
        In increasing order of `max_entropy`.
    entropy : float
        Mean binary entropy of the prior, in bits per bit.

    Returns
    -------
    int
        Index of the first code that is meant for at least this entropy, else the last.
    """
    for index, code in enumerate(codes):
        if entropy <= code.max_entropy:
            return index
    return len(codes) - 1
