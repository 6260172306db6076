"""Slepian-Wolf coding: parity rate over entropy, undetected errors, speed of the SISO decoder."""

import math
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures.harness import Figure, Measured, Setting

if TYPE_CHECKING:
    from dvc.slepian_wolf import PlaneResult, SlepianWolfSettings

NUM_BITS = 6336
SEED = 20081
ASKED = {0.01: 1.45, 0.03: 1.20, 0.07: 1.18, 0.12: 1.16, 0.20: 1.18}
"""Most parity rate over entropy that is asked, by crossover probability."""
CLASSICAL = {0.01: 1.59, 0.03: 1.32, 0.07: 1.24, 0.12: 1.26, 0.20: 1.23}
MOST_UNDETECTED = 1e-4


def entropy(probability: float) -> float:
    """Return the binary entropy."""
    return -sum(value * math.log2(value) for value in (probability, 1 - probability))


def decode_plane(
    bits: NDArray[np.uint8], llr_ch: NDArray[np.float64], settings: "SlepianWolfSettings", seed: int
) -> "PlaneResult":
    """Code a bit plane and decode it, as encoder and decoder of a video do."""
    from dvc import slepian_wolf

    codes = slepian_wolf.family(settings.family)
    parities: dict[int, NDArray[np.uint8]] = {}
    check = slepian_wolf.crc(bits, settings.crc_bits)
    decoding = slepian_wolf.decode_plane(
        llr_ch, lambda code: slepian_wolf.TurboDecoder(codes[code], bits.size, seed), settings
    )

    def _answer(request: slepian_wolf.ParityRequest) -> NDArray[np.uint8]:
        if request.kind == "parity" and request.code not in parities:
            parities[request.code] = slepian_wolf.encode_planes(bits[np.newaxis], codes[request.code], seed)[
                0
            ]
        released = {"crc": check, "uncoded": bits}.get(request.kind, parities.get(request.code, bits))
        return released[request.start : request.start + request.count]

    return slepian_wolf.drive(decoding, _answer)


def noisy_plane(
    num_bits: int, probabilities: float | NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Draw a plane and side information that differs from it with known probabilities."""
    bits = rng.integers(0, 2, num_bits, dtype=np.uint8)
    flipped = (rng.random(num_bits) < probabilities).astype(np.uint8)
    signs = 1.0 - 2.0 * (bits ^ flipped)
    odds = np.broadcast_to((1 - probabilities) / np.asarray(probabilities), (num_bits,))
    return bits, np.asarray(signs * np.log(odds), np.float64)


def efficiency(setting: Setting, _clip: str, probability: float) -> Measured:
    """Measure the parity rate over the entropy on a binary symmetric channel, stop by check bits."""
    from dvc.slepian_wolf import SlepianWolfSettings

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


def undetected_errors(setting: Setting, _clip: str) -> Measured:
    """Count planes that the decoder takes for right and that are not."""
    from scipy.stats import beta

    from dvc.slepian_wolf import SlepianWolfSettings

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
    return Measured(text, upper < MOST_UNDETECTED, values)


def plain_siso(
    llr_a: NDArray[np.float64], parity: NDArray[np.int8], feedback: int, feedforward: int
) -> NDArray[np.float64]:
    """Compute the extrinsic LLRs of a trellis in plain numpy, step by step in the log domain."""
    from dvc.slepian_wolf.turbo.trellis import trellis

    table = trellis(feedback, feedforward)
    follow, emitted = table.next_state, table.output
    allowed = (parity[:, np.newaxis, np.newaxis] < 0) | (parity[:, np.newaxis, np.newaxis] == emitted)
    gamma_p = np.where(allowed, 0.0, -np.inf)  # (T, S, 2): what the parity says
    gamma_a = 0.5 * llr_a[:, np.newaxis] * np.array([1.0, -1.0])  # (T, 2): what is known before
    alpha = np.full((llr_a.size + 1, table.num_states), -np.inf)
    alpha[0, 0] = 0.0
    for t in range(llr_a.size):
        edges = alpha[t, :, np.newaxis] + gamma_p[t] + gamma_a[t]
        np.logaddexp.at(alpha[t + 1], follow, edges)
        alpha[t + 1] -= alpha[t + 1].max()
    beta = np.zeros(table.num_states)
    llr_e = np.empty(llr_a.size)
    for t in range(llr_a.size - 1, -1, -1):
        edges = alpha[t, :, np.newaxis] + gamma_p[t] + beta[follow]
        llr_e[t] = np.subtract(*np.logaddexp.reduce(edges, axis=0))
        beta = np.logaddexp.reduce(gamma_p[t] + gamma_a[t] + beta[follow], axis=1)
        beta -= beta.max()
    return llr_e


def siso_speed(setting: Setting, _clip: str) -> Measured:
    """Compare the compiled pass over a trellis with the plain one in the same run, result and time."""
    from dvc import slepian_wolf
    from dvc.slepian_wolf.turbo.siso import LaneDecoder, lane_layout, siso

    (code,) = slepian_wolf.family("classical")
    rng = np.random.default_rng(SEED)
    bits, llr_ch = noisy_plane(NUM_BITS, 0.07, rng)
    parity = slepian_wolf.encode_planes(bits[np.newaxis], code, 1)[0]
    decoder = slepian_wolf.TurboDecoder(code, NUM_BITS, 1)
    decoder.start(llr_ch)
    decoder.add_parity(parity[: NUM_BITS // 2])
    iteration_s = _seconds(lambda: decoder.polish(1), setting.choose(200, 20))
    known = np.where(rng.random(NUM_BITS) < 0.25, rng.integers(0, 2, NUM_BITS), -1).astype(np.int8)
    arguments = known, code.feedback, code.feedforward
    plain_s = _seconds(lambda: plain_siso(llr_ch, *arguments), 1)
    exact = np.clip(plain_siso(llr_ch, *arguments), -20, 20)
    difference = float(np.abs(np.clip(siso(llr_ch, *arguments), -20, 20) - exact).max())
    lanes = LaneDecoder(code.feedback, code.feedforward, lane_layout((0, NUM_BITS)))
    lanes.prob0.fill(0.5)
    lanes.prob1.fill(0.5)
    compiled_s = _seconds(lanes.run, setting.choose(500, 50))
    ratio, speed_mbps = plain_s / compiled_s, NUM_BITS / iteration_s / 1e6
    values = {"ratio": ratio, "plain_s": plain_s, "compiled_s": compiled_s, "speed_mbit_per_s": speed_mbps}
    values["largest_difference"] = difference
    text = f"{ratio:.0f} times; {speed_mbps:.1f} Mbit/s per full iteration"
    return Measured(
        text, ratio >= 100 and difference < 0.05, values, f"LLRs differ by {difference:.0e} at most"
    )


def _seconds(function: Callable[[], object], repetitions: int) -> float:
    """Return the median time of a call, after one that is not counted."""
    function()
    times_s = []
    for _ in range(repetitions):
        started = time.perf_counter()
        function()
        times_s.append(time.perf_counter() - started)
    return statistics.median(times_s)


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
    Figure(
        AREA, "siso-speed", "SISO decoder, N = 6336, compiled against plain numpy", "≥ 100 times", siso_speed
    ),
    Figure(
        AREA,
        "undetected-errors",
        "planes taken for right that are not",
        "< 1e-4 with 95 % confidence",
        undetected_errors,
    ),
)
"""Figures of this area."""
