"""Quality: one QP that sets key frames, Wyner-Ziv steps and requests together, or a DISCOVER matrix."""

from dataclasses import dataclass

from dvc.config.fields import check_range, shown
from dvc.config.sections import (
    DEFAULT_QP,
    DISCOVER_LEVELS,
    MAX_QP,
    ZIGZAG,
    WynerZivConfig,
)
from dvc.errors import ConfigError

_KEY_QP = (40, 39, 38, 34, 34, 32, 29, 25)  # for Q1 to Q8: the published choice for the foreman sequence


@dataclass(frozen=True)
class Qp:
    """A quality on H.264's scale: key frames, steps and requests share bits by one Lagrange multiplier.

    Attributes
    ----------
    qp : int
        From 1 to `MAX_QP`; that of the key frames.
    """

    qp: int = DEFAULT_QP

    def __post_init__(self) -> None:
        """Refuse what is off the scale."""
        check_range("qp", self.qp, 1, MAX_QP)

    @property
    def key_qp(self) -> int:
        """H.264 quantisation parameter of the key frames."""
        return self.qp

    @property
    def wyner_ziv(self) -> WynerZivConfig:
        """Embedded quantisers."""
        return WynerZivConfig(qp=self.qp)


@dataclass(frozen=True)
class DiscoverMatrix:
    """One of the eight quantisation matrices of the DISCOVER codec; all planes are asked for.

    Attributes
    ----------
    q : int
        From 1 (coarsest) to 8 (finest).
    """

    q: int

    def __post_init__(self) -> None:
        """Refuse a matrix that does not exist."""
        if type(self.q) is not int or not 1 <= self.q <= len(DISCOVER_LEVELS):
            raise ConfigError(f"the quantiser must be from 1 to {len(DISCOVER_LEVELS)}, got {shown(self.q)}")

    @property
    def key_qp(self) -> int:
        """H.264 quantisation parameter that gives key frames about the same quality."""
        return _KEY_QP[self.q - 1]

    @property
    def wyner_ziv(self) -> WynerZivConfig:
        """Levels that share the range of each band, and the noise model alone for priors."""
        levels = tuple(DISCOVER_LEVELS[self.q - 1][position] for position in ZIGZAG)
        return WynerZivConfig(levels, priors="laplacian")


Quality = Qp | DiscoverMatrix
