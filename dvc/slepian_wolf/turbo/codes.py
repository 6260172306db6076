"""Descriptions of turbo codes, the presets, and the choice of a code by entropy."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from dvc.slepian_wolf.turbo.trellis import memory

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

# Degree profiles from linear programs over EXIT curves and simulation: `benchmarks/searches/turbo_codes.py`.
_FOUR_STATES = (0b111, 0b101)
_FOUR_STATES_REVERSED = (0b101, 0b111)
_EIGHT_STATES = (0b1011, 0b1101)
_EIGHT_STATES_REVERSED = (0b1101, 0b1011)
_SIXTEEN_STATES = (0b11001, 0b11011)


def _joined(
    name: str,
    polynomials: tuple[int, int],
    copies: tuple[tuple[float, int], ...],
    grid_rate: float,
    max_entropy: float,
    spread: int = 20,
) -> TurboCode:
    return TurboCode(name, *polynomials, copies, grid_rate=grid_rate, spread=spread, max_entropy=max_entropy)


ADAPTIVE = (
    _joined("H03", _EIGHT_STATES_REVERSED, ((1.0, 3),), 0.0, 0.038, 40),
    _joined("H05", _SIXTEEN_STATES, ((0.833, 2), (0.142, 8), (0.025, 12)), 0.065, 0.063, 40),
    _joined("H08", _SIXTEEN_STATES, ((0.862, 2), (0.011, 8), (0.098, 10), (0.029, 30)), 0.099, 0.098, 40),
    _joined("H12", _SIXTEEN_STATES, ((0.899, 2), (0.033, 4), (0.068, 12)), 0.147, 0.143, 40),
    _joined("H17", _EIGHT_STATES_REVERSED, ((0.827, 2), (0.026, 8), (0.138, 10), (0.009, 30)), 0.216, 0.198),
    _joined("H23", _EIGHT_STATES, ((0.876, 2), (0.124, 12)), 0.269, 0.263),
    _joined("H30", _EIGHT_STATES, ((0.899, 2), (0.064, 8), (0.037, 30)), 0.348, 0.338),
    _joined("H38", _FOUR_STATES, ((0.855, 2), (0.113, 8), (0.032, 20)), 0.418, 0.423),
    _joined("H47", _FOUR_STATES, ((0.901, 2), (0.064, 10), (0.035, 12)), 0.56, 0.52),
    _joined("H57", _FOUR_STATES, ((0.934, 2), (0.039, 12), (0.011, 15), (0.016, 30)), 0.657, 0.622),
    _joined("H68", _FOUR_STATES_REVERSED, ((0.943, 2), (0.057, 12)), 0.784, 0.69),
    _joined("H74", _FOUR_STATES_REVERSED, ((0.786, 2), (0.065, 3), (0.091, 7), (0.058, 15)), 0.754, 0.765),
    _joined("H80", _FOUR_STATES_REVERSED, ((0.953, 2), (0.014, 15), (0.019, 20), (0.014, 30)), 0.845, 1.0),
)

_FAMILIES = {"classical": (CLASSICAL,), "adaptive": ADAPTIVE}


def family(name: str = "adaptive") -> tuple[TurboCode, ...]:
    """Return the codes of a family, in order of the entropy that they are meant for."""
    if name not in _FAMILIES:
        raise ValueError(f"`name` must be one of {sorted(_FAMILIES)}, got {name!r}")
    return _FAMILIES[name]


def choose_code(codes: Sequence[TurboCode], entropy: float) -> int:
    """Pick the code of a family for a plane."""
    for index, code in enumerate(codes):
        if entropy <= code.max_entropy:
            return index
    return len(codes) - 1
