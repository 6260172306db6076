"""Slepian-Wolf coding: parity rate over entropy, undetected errors, speed of the SISO decoder."""

import math
import statistics
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Figure, Measured, Setting

if TYPE_CHECKING:
    from dvc.turbo import PlaneResult, SlepianWolfSettings

NUM_BITS = 6336
SEED = 20081
ASKED = {0.01: 1.45, 0.03: 1.20, 0.07: 1.18, 0.12: 1.16, 0.20: 1.18}
"""Most parity rate over entropy that is asked, by crossover probability."""
CLASSICAL = {0.01: 1.59, 0.03: 1.32, 0.07: 1.24, 0.12: 1.26, 0.20: 1.23}
MOST_UNDETECTED = 1e-4


def entropy(probability: float) -> float:
    """Return the binary entropy.

    Parameters
    ----------
    probability : float
        Between 0 and 1.

    Returns
    -------
    float
        In bits.
    """
    return -sum(value * math.log2(value) for value in (probability, 1 - probability))


def decode_plane(
    bits: NDArray[np.uint8], llr_ch: NDArray[np.float64], settings: "SlepianWolfSettings", seed: int
) -> "PlaneResult":
    """Code a bit plane and decode it, as encoder and decoder of a video do.

    Parameters
    ----------
    bits : ndarray of shape (N,), uint8
        The plane.
    llr_ch : ndarray of shape (N,), float64
        Side information as LLR of every bit.
    settings : SlepianWolfSettings
        Of the decoder.
    seed : int
        Of the interleavers.

    Returns
    -------
    PlaneResult
        What the decoder found, and at which price.
    """
    from dvc import turbo

    codes = turbo.family(settings.family)
    parities: dict[int, NDArray[np.uint8]] = {}
    check = turbo.crc(bits, settings.crc_bits)
    decoding = turbo.decode_plane(
        llr_ch, lambda code: turbo.TurboDecoder(codes[code], bits.size, seed), settings
    )
    try:
        request = next(decoding)
        while True:
            if request.kind == "parity" and request.code not in parities:
                parities[request.code] = turbo.encode_planes(bits[np.newaxis], codes[request.code], seed)[0]
            released = {"crc": check, "plain": bits}.get(request.kind, parities.get(request.code, bits))
            request = decoding.send(released[request.start : request.start + request.count])
    except StopIteration as end:
        result: PlaneResult = end.value
        return result


def noisy_plane(
    num_bits: int, probabilities: float | NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Draw a plane and side information that differs from it with known probabilities.

    Parameters
    ----------
    num_bits : int
        Length of the plane.
    probabilities : float or ndarray of shape (num_bits,)
        Of a difference, per bit.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    bits : ndarray of shape (num_bits,), uint8
        The plane.
    llr_ch : ndarray of shape (num_bits,), float64
        The true LLRs of the side information.
    """
    bits = rng.integers(0, 2, num_bits, dtype=np.uint8)
    flipped = (rng.random(num_bits) < probabilities).astype(np.uint8)
    signs = 1.0 - 2.0 * (bits ^ flipped)
    odds = np.broadcast_to((1 - probabilities) / np.asarray(probabilities), (num_bits,))
    return bits, np.asarray(signs * np.log(odds), np.float64)


def efficiency(setting: Setting, _clip: str | None, probability: float) -> Measured:
    """Measure the parity rate over the entropy on a binary symmetric channel, stop by check bits.

    Parameters
    ----------
    setting : Setting
        How thoroughly.
    _clip : None
        None.
    probability : float
        Of a crossover.

    Returns
    -------
    Measured
        The mean over planes, and its standard error.
    """
    from dvc.turbo import SlepianWolfSettings

    rng = np.random.default_rng([SEED, round(1000 * probability)])
    settings, num_planes = SlepianWolfSettings(), setting.choose(100, 3)
    ratios, check_bits, wrong = [], [], 0
    for _ in range(num_planes):
        bits, llr_ch = noisy_plane(NUM_BITS, probability, rng)
        result = decode_plane(bits, llr_ch, settings, seed=1)
        ratios.append(result.parity_bits / (NUM_BITS * entropy(probability)))
        check_bits.append(result.crc_bits)
        wrong += not np.array_equal(result.bits, bits)
    mean, error = statistics.fmean(ratios), statistics.stdev(ratios) / math.sqrt(num_planes)
    values = {"ratio": mean, "standard_error": error, "num_planes": num_planes, "num_wrong_planes": wrong}
    values["crc_bits_per_plane"] = statistics.fmean(check_bits)
    text = f"{mean:.3f} ± {error:.3f}"
    return Measured(
        text, mean <= ASKED[probability] and not wrong, values, f"{num_planes} planes, {wrong} wrong"
    )


def undetected_errors(setting: Setting, _clip: str | None) -> Measured:
    """Count planes that the decoder takes for right and that are not.

    Short planes, of the size of a small picture's bands, whose side information is a mixture of sure and
    unsure bits: many of them pass the check without any parity, where an error is likeliest to slip through.

    Parameters
    ----------
    setting : Setting
        How thoroughly.
    _clip : None
        None.

    Returns
    -------
    Measured
        The share, and the upper end of its 95 % confidence interval.
    """
    from scipy.stats import beta

    from dvc.turbo import SlepianWolfSettings

    rng = np.random.default_rng(SEED)
    settings, num_planes, num_bits = SlepianWolfSettings(), setting.choose(40_000, 200), 396
    undetected = failed = 0
    for _ in range(num_planes):
        unsure = rng.random(num_bits) < rng.choice([0.0, 0.01, 0.05, 0.3])
        probabilities = np.where(unsure, 0.2, rng.choice([0.0005, 0.002, 0.01]))
        bits, llr_ch = noisy_plane(num_bits, probabilities, rng)
        result = decode_plane(bits, llr_ch, settings, seed=1)
        failed += not result.success
        undetected += result.success and not np.array_equal(result.bits, bits)
    upper = float(beta.ppf(0.95, undetected + 1, num_planes - undetected))
    values = {"num_undetected": undetected, "num_failed": failed, "num_planes": num_planes, "upper_95": upper}
    text = f"{undetected} of {num_planes} planes; below {upper:.1e} with 95 % confidence"
    enough = upper < MOST_UNDETECTED or undetected / num_planes > MOST_UNDETECTED
    return Measured(text, upper < MOST_UNDETECTED if enough else None, values)


def _efficiency_figures() -> list[Figure]:
    measures: dict[float, Callable[[Setting, str | None], Measured]] = {
        probability: partial(efficiency, probability=probability) for probability in ASKED
    }
    return [
        Figure(
            AREA,
            f"efficiency-{probability:.2f}",
            f"parity rate over entropy, N = {NUM_BITS}, p = {probability:.2f}",
            f"≤ {ASKED[probability]:.2f} (classical design {CLASSICAL[probability]:.2f})",
            measure,
        )
        for probability, measure in measures.items()
    ]


AREA = "turbo"
FIGURES = (
    *_efficiency_figures(),
    Figure(AREA, "undetected-errors", "planes taken for right that are not", "< 1e-4", undetected_errors),
)
"""Figures of this area."""
