"""Weights that priors of bit planes begin with.

``python -m benchmarks.searches.priors [CLIP ...] --qp 32 --frames 33`` codes clips with the default codec and
decodes them; of each plane the terms of the LLRs and the bits are kept, for some of its coefficients. The
command prints, for each class of planes, the weights of a logistic regression over all clips, which weigh the
same, and by how much weights that are found without a clip change its code length, over that by the priors
that learn. The weights in `dvc.wynerziv.priors` were found on the nine clips of the results at QP 32.
"""

import argparse
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from unittest import mock

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from benchmarks.results.harness import CLIPS
from benchmarks.stages import coded, decoded
from dvc.slepian_wolf.coupling import bounded_llr, ideal_bits
from dvc.wynerziv import priors

Array = NDArray[np.float64]
Bits = NDArray[np.uint8]
EVERY = 16
"""Number of coefficients of a plane for each sample."""
RIDGE = 3.0
"""Precision of weights around those of the plain Laplacian."""


class Samples(list[tuple[Array, Array, Bits]]):
    """Terms (K, N), LLRs (N,) that were used, and bits (N,) of the planes of one class."""

    def together(self) -> tuple[Array, Array, Bits]:
        """Join them."""
        terms, llrs, bits = zip(*self, strict=True)
        return np.concatenate(terms, axis=1), np.concatenate(llrs), np.concatenate(bits)


def met(stream: bytes) -> dict[int, Samples]:
    """Decode a stream, and return the priors of its planes by class."""
    found: dict[int, Samples] = defaultdict(Samples)
    usual = priors.LearnedPriors.learn

    def noted(self, prior, bits):  # type: ignore[no-untyped-def]
        own = found[priors._class_of(*prior.position)]
        own.append((prior.inputs[:, ::EVERY], prior.llr[::EVERY], bits[::EVERY]))
        usual(self, prior, bits)

    with mock.patch.object(priors.LearnedPriors, "learn", noted):
        decoded(stream)
    return found


def code_length(llr: Array, bits: Bits) -> float:
    """Return the ideal code length in bits, by LLRs as a decoder would use them."""
    return ideal_bits(bounded_llr(llr), bits)


def fitted(clips: Sequence[tuple[Array, Array, Bits]]) -> Array:
    """Fit weights to several clips of equal weight."""
    count = min(bits.size for _, _, bits in clips)
    rng = np.random.default_rng(0)
    picked = [rng.permutation(bits.size)[:count] for _, _, bits in clips]
    inputs = np.concatenate([terms[:, own] for (terms, _, _), own in zip(clips, picked, strict=True)], axis=1)
    bits = np.concatenate([bits[own] for (_, _, bits), own in zip(clips, picked, strict=True)])
    start = np.eye(1, len(inputs)).ravel()

    def cost(weights: Array) -> tuple[float, Array]:
        llr = weights @ inputs
        value = np.logaddexp(0.0, np.where(bits == 1, llr, -llr)).sum()
        slope = inputs @ (1.0 / (1.0 + np.exp(-llr)) - (1.0 - bits))
        change = weights - start
        return float(value + RIDGE * change @ change), slope + 2.0 * RIDGE * change

    found: Array = minimize(cost, start, jac=True, method="L-BFGS-B").x
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser("python -m benchmarks.searches.priors", description=__doc__)
    parser.add_argument("clips", nargs="*", default=list(CLIPS), metavar="CLIP")
    parser.add_argument("--qp", type=int, nargs="+", default=[32])
    parser.add_argument("--frames", type=int, default=33)
    parser.add_argument("--out", type=Path, default=Path("out/priors"), help="folder of streams")
    parsed = parser.parse_args(arguments)
    parsed.out.mkdir(parents=True, exist_ok=True)
    planes: dict[str, dict[int, Samples]] = {}
    for clip in parsed.clips:
        own = planes[clip] = defaultdict(Samples)
        for qp in parsed.qp:
            for number, samples in met(coded(clip, qp, parsed.frames, parsed.out)).items():
                own[number].extend(samples)
    for number in sorted({number for own in planes.values() for number in own}):
        joined = {clip: own[number].together() for clip, own in planes.items() if number in own}
        weights = fitted(list(joined.values()))
        print(f"class {number}:", ", ".join(f"{weight:.2f}" for weight in weights))
        for clip, (terms, llr, bits) in joined.items():
            rest = [own for other, own in joined.items() if other != clip] or [joined[clip]]
            change = code_length(fitted(rest) @ terms, bits) / code_length(llr, bits)
            print(f"  {clip:10} {100.0 * (change - 1.0):+5.1f} %")


if __name__ == "__main__":
    main()
