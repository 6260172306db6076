"""Search for irregular turbo codes: degree profiles by linear programming over EXIT curves, then by decoding.

``python -m benchmarks.searches.turbo_codes 0.19 0.37`` prints the best codes found for planes of these
entropies, in bits per bit. A minute or two per entropy.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from benchmarks.searches.exit_curves import best_profile, exit_curve
from dvc.slepian_wolf import TurboCode, TurboDecoder, encode_planes
from dvc.slepian_wolf.turbo.trellis import trellis

CONSTITUENTS = (
    (0b111, 0b101),
    (0b101, 0b111),
    (0b1101, 0b1011),
    (0b1011, 0b1101),
    (0b11001, 0b11011),
)
MEAN_COPIES = (2.2, 2.35, 2.5, 2.7, 2.9, 3.1, 3.4, 3.7)
SPREAD = 20


@dataclass(frozen=True)
class Candidate:
    """A code and the parity rate over entropy that it is predicted to need, or needed."""

    code: TurboCode
    ratio: float


def entropy(probability: float) -> float:
    """Return the binary entropy."""
    return -sum(value * math.log2(value) for value in (probability, 1 - probability))


def predicted(crossover: float) -> list[Candidate]:
    """List codes by the parity rate at which their EXIT curves stop to cross."""
    doubt = entropy(crossover)
    a_priori = 1 - doubt * (1 - np.concatenate([np.linspace(0, 0.9, 19), [0.93, 0.96, 0.98]]))
    found: dict[tuple[object, ...], Candidate] = {}
    for polynomials in CONSTITUENTS:
        for mean_copies in MEAN_COPIES:
            gap = mean_copies / (1.05 * doubt)
            curve = exit_curve(polynomials, gap, a_priori)
            for most_copies in (8, 12, 20, 30):
                shares = best_profile(curve, a_priori, crossover, most_copies, 0.02)
                if shares is None:
                    continue
                first = min(shares)
                shares[first] = round(1 - sum(share for count, share in shares.items() if count != first), 3)
                rate = sum(count * share for count, share in shares.items()) / gap
                copies = tuple((share, count) for count, share in sorted(shares.items()))
                name = f"{polynomials[0]:b}/{polynomials[1]:b}"
                code = TurboCode(name, *polynomials, copies, grid_rate=min(1.0, rate * 1.04), spread=SPREAD)
                found[polynomials, copies] = Candidate(code, rate / doubt)
    return sorted(found.values(), key=lambda candidate: candidate.ratio)


def needed(code: TurboCode, num_bits: int, crossover: float, num_planes: int, seed: int) -> float:
    """Measure the parity rate over entropy at which iterations succeed, with the true plane telling when."""
    rng = np.random.default_rng(seed)
    decoder = TurboDecoder(code, num_bits, 1)
    doubt_bits = entropy(crossover) * num_bits
    total = 0
    for _ in range(num_planes):
        bits = rng.integers(0, 2, num_bits, dtype=np.uint8)
        seen = bits.copy()
        seen[rng.permutation(num_bits)[: round(crossover * num_bits)]] ^= 1
        parity = encode_planes(bits[np.newaxis], code, 1)[0]
        decoder.start((1 - 2.0 * seen) * math.log((1 - crossover) / crossover))
        decoder.add_parity(parity[: round(0.98 * doubt_bits)])
        decoder.iterate(40)
        while not np.array_equal(decoder.decisions, bits) and decoder.num_parity < min(
            num_bits, 1.6 * doubt_bits
        ):
            decoder.add_parity(parity[decoder.num_parity :][: max(1, round(0.015 * doubt_bits))])
            decoder.iterate(8)
        total += decoder.num_parity
    return total / num_planes / doubt_bits


def search(doubt: float, num_tried: int) -> list[Candidate]:
    """Predict codes for an entropy and try the best of them on bands of QCIF and CIF pictures."""
    crossover = float(brentq(lambda p: entropy(p) - doubt, 1e-7, 0.5 - 1e-9))
    tried = []
    for candidate in predicted(crossover)[:num_tried]:
        ratios = [needed(candidate.code, size, crossover, count, 1) for size, count in ((1584, 8), (6336, 4))]
        tried.append(Candidate(candidate.code, sum(ratios) / 2))
    return sorted(tried, key=lambda candidate: candidate.ratio)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the best codes for some entropies."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("entropy", type=float, nargs="+", help="mean entropy of the planes, bits per bit")
    parser.add_argument(
        "--tried", type=int, default=16, help="codes to try by decoding; default: %(default)s"
    )
    arguments = parser.parse_args(argv)
    for doubt in arguments.entropy:
        for candidate in search(doubt, arguments.tried)[:4]:
            code = candidate.code
            states = trellis(code.feedback, code.feedforward).num_states
            print(f"{doubt:.3f}  {candidate.ratio:.3f}  {states:2d} states  {code}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
