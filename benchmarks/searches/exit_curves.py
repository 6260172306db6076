"""EXIT curves of trellises, and the degree profiles with which decoding converges on them."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from dvc.slepian_wolf._kernels import bit_probabilities
from dvc.slepian_wolf.turbo import _kernels as kernels
from dvc.slepian_wolf.turbo.siso import LaneDecoder, lane_layout

Floats = NDArray[np.float64]
COPY_COUNTS = (2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30)
EXIT_STEPS = 96_000
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(61)
MEANS = np.concatenate([[0.0], np.geomspace(1e-4, 120, 400)])


def information(means: Floats, llr_ch: Sequence[tuple[float, float]] = ((0.0, 1.0),)) -> Floats:
    """Return the mutual information of a bit and the sum of a channel LLR and a consistent Gaussian."""
    spread = means[:, np.newaxis] + np.sqrt(2 * means[:, np.newaxis]) * NODES
    losses = [p * (WEIGHTS * np.logaddexp(0, -(llr + spread))).sum(axis=1) for llr, p in llr_ch]
    return np.asarray(1 - sum(losses) / (WEIGHTS.sum() * math.log(2)))


def exit_curve(polynomials: tuple[int, int], gap: float, a_priori: Floats) -> Floats:
    """Measure the extrinsic information of a trellis of which every `gap`-th parity bit is known."""
    rng = np.random.default_rng(0)
    lanes = lane_layout((0, EXIT_STEPS))
    known = np.unique(np.floor(np.arange(EXIT_STEPS / gap - 1) * gap).astype(np.int32))
    found = []
    for mean in np.interp(a_priori, information(MEANS), MEANS):
        decoder = LaneDecoder(*polynomials, lanes)
        decoder.set_parity(known, np.zeros(known.size, np.uint8))
        llr = rng.normal(mean, math.sqrt(2 * mean), decoder.llr_a.size)
        decoder.llr_a[:] = np.clip(llr, -kernels.MAX_EXTRINSIC, kernels.MAX_EXTRINSIC)
        for _ in range(2):
            bit_probabilities(decoder.llr_a, decoder.prob0, decoder.prob1)
            decoder.run()
        found.append(1 - np.logaddexp(0, -decoder.llr_e.astype(float)).mean() / math.log(2))
    return np.maximum.accumulate(np.clip(found, 0, 1))


def best_profile(
    curve: Floats, a_priori: Floats, crossover: float, most_copies: int, margin: float
) -> dict[int, float] | None:
    """Find the shares of bits by number of copies with the shortest trellis on which decoding converges."""
    llr = math.log((1 - crossover) / crossover)
    copies = np.array([count for count in COPY_COUNTS if count <= most_copies])
    means = np.interp(curve, information(MEANS), MEANS)
    channel = ((llr, 1 - crossover), (-llr, crossover))
    bits = np.stack([information((count - 1) * means, channel) for count in copies], axis=1)
    wanted = a_priori + margin * (1 - a_priori)
    solved = linprog(-1 / copies, A_ub=-bits, b_ub=-wanted, A_eq=np.ones((1, copies.size)), b_eq=[1.0])
    if solved.status != 0:
        return None
    shares = solved.x / copies / (solved.x / copies).sum()
    return {
        int(count): round(float(share), 3)
        for count, share in zip(copies, shares, strict=True)
        if share > 5e-4
    }
