"""Where bits pay: one quality that sets key frames, Wyner-Ziv steps and requests together."""

import math
from dataclasses import dataclass

from dvc.config.sections import WynerZivConfig

MAX_QP = 51
DEFAULT_QP = 30
ALLOCATED_FAMILY = "cascade"
"""Codes of the bit planes: those that cost the least."""
ANCHOR_DISTANCE = 8
"""Most frames from one anchor to the next."""
INTRA_PERIOD = 96
"""Most frames between key frames: what is lost is back, and a player may start, after three seconds or so."""
ONE_WAY_INTRA_PERIOD = 16
"""The same where no decoder asks: anchors that rest on anchors need more than can be estimated."""
SLOPE_PER_KEY_SLOPE = 4.0
"""Squared error that a bit must save in frames that predict no other, where it is 1 in key frames."""
SLOPE_PERCENT = (100, 60, 40, 30, 30, 15)
"""Share of that slope in frames with references up to 2, 4, 8, 16, 32 frames apart, which predict others, and
in anchors, which predict the most."""
STEP_PER_ROOT_SLOPE = 3.0
"""Finest step: that of a fine uniform quantiser, of which a bit saves 2 ln 2 / 12 squared steps."""


@dataclass(frozen=True)
class Allocation:
    """How bits are shared at one quality.

    Attributes
    ----------
    key_qp : int
        H.264 quantisation parameter of the key frames.
    wyner_ziv : WynerZivConfig
        Nested bins, and the slopes up to which planes are asked for.
    """

    key_qp: int
    wyner_ziv: WynerZivConfig

    def step(self, distance: int) -> float:
        """Return the width of the finest bins of a frame.

        Parameters
        ----------
        distance : int
            Frames from one to the other of the references around it.

        Returns
        -------
        float
            Step in coefficient units.
        """
        return STEP_PER_ROOT_SLOPE * math.sqrt(self.wyner_ziv.slope_between(distance))


def key_slope(qp: int) -> float:
    """Return what a bit saves in an H.264 picture: the usual Lagrangian multiplier of its encoders.

    Parameters
    ----------
    qp : int
        H.264 quantisation parameter.

    Returns
    -------
    float
        Squared error per bit, 0.85 * 2^((QP - 12) / 3).

    References
    ----------
    T. Wiegand, B. Girod, "Lagrange multiplier selection in hybrid video coder control", ICIP 2001.
    """
    return float(0.85 * 2.0 ** ((qp - 12) / 3))


def allocation(qp: int) -> Allocation:
    """Share bits at a quality so that they pay alike everywhere.

    Parameters
    ----------
    qp : int
        On H.264's scale, 1 to `MAX_QP`.

    Returns
    -------
    Allocation
        Key frames of this QP; in Wyner-Ziv frames a bit must save more, most where they predict no other.
    """
    slope = SLOPE_PER_KEY_SLOPE * key_slope(qp)
    wyner_ziv = WynerZivConfig(quantizer="nested", slope=slope, slope_percent=SLOPE_PERCENT, priors="learned")
    return Allocation(qp, wyner_ziv)
