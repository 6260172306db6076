"""Rate control: the slope at which a stream is as long as it may be."""

import math
from collections.abc import Callable

from dvc.dibr.codec.encoder import Encoded
from dvc.errors import ConfigError

FIRST_SLOPE = 2e-3
"""About that of 0.5 bits a pixel."""
STEEPEST, FLATTEST = 10.0, 1e-8
TOLERANCE = 0.005
"""Share of the budget that may be left."""
MAX_STEPS = 12


def encode_to_size(
    encode: Callable[[float], Encoded], max_bytes: int, first_slope: float = FIRST_SLOPE
) -> Encoded:
    """Encode at the slope whose stream fits a size best.

    Parameters
    ----------
    encode : callable
        Encodes at a slope; flatter slopes give longer streams.
    max_bytes : int
        The longest stream that is wanted.
    first_slope : float, optional
        What to try first.

    Returns
    -------
    Encoded
        The longest stream found that fits; shorter by at most `TOLERANCE` where lengths change that finely.

    Raises
    ------
    ConfigError
        If not even the steepest slope gives so short a stream.
    """
    found = encode(min(max(first_slope, FLATTEST), STEEPEST))
    fits: Encoded | None = None
    exceeds: Encoded | None = None
    for _ in range(MAX_STEPS):
        if len(found.data) <= max_bytes:
            fits = found
        else:
            exceeds = found
        if len(found.data) == max_bytes or _is_close(fits, max_bytes):
            break
        slope = _next_slope(fits, exceeds, max_bytes)
        if not FLATTEST <= slope <= STEEPEST:
            break
        found = encode(slope)
    if fits is None:
        least = encode(STEEPEST)
        if len(least.data) > max_bytes:
            raise ConfigError(f"{max_bytes} bytes are too few: these views need {len(least.data)} at least")
        fits = least
    return fits


def _is_close(fits: Encoded | None, max_bytes: int) -> bool:
    return fits is not None and len(fits.data) >= (1.0 - TOLERANCE) * max_bytes


def _next_slope(fits: Encoded | None, exceeds: Encoded | None, max_bytes: int) -> float:
    """Interpolate between both ends, or go on beyond the only one; in logarithms."""
    if fits is None or exceeds is None:
        known = fits or exceeds
        assert known is not None
        excess = math.log(len(known.data) / max_bytes)
        # squared errors fall with about the square of the rate
        step = math.copysign(max(2.0 * abs(excess), 0.02), excess)
        return known.slope * math.exp(max(-math.log(16.0), min(math.log(16.0), 1.1 * step)))
    wanted = (1.0 - 0.4 * TOLERANCE) * max_bytes
    low, high = math.log(len(fits.data)), math.log(len(exceeds.data))
    share = (math.log(wanted) - low) / max(high - low, 1e-9)
    share = min(max(share, 0.05), 0.95)
    return math.exp(math.log(fits.slope) + share * (math.log(exceeds.slope) - math.log(fits.slope)))
