"""Weights of the confidence of surfaces: the order of pixels that is nearest to that of their errors.

``python -m benchmarks.searches.confidence [--pairs teddy Baby1] [--halve]`` reconstructs pairs below
``../shared/stereo`` and prints for each the area under the sparsification curve (errors beyond 1 px, all
pixels with known truth, in per cent): without any order, with the weights of
`surface_completion`, with weights found on the other pairs, and of the best order. Finally it
prints the weights found on all; those in use come from `TUNING_PAIRS` of `surfaces`. ``--pairs test``
selects the test pairs.
"""

import argparse
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from benchmarks.searches.surfaces import Pair, add_pair_options, chosen_pairs
from dvc.geometry.camera_array import DisparityLabels
from dvc.stereo.evaluation import sparsification
from dvc.stereo.surfaces.reconstruct import reconstruct
from dvc.stereo.surfaces.surface_completion import WEIGHTS, Evidence, evidence

Floats = NDArray[np.float64]
Sample = tuple[Floats, NDArray[np.bool_]]
"""Measures of pixels, (pixels, 5), and which of these are bad."""

SAMPLES = 20_000
"""Pixels of each pair that weights are found on, so that all pairs count alike."""


def measured(pair: Pair, jobs: int) -> Sample:
    """Return measures of the pixels of a pair, and which are bad."""
    labels = DisparityLabels(0.0, 1.0, pair.highest + 1)
    maps = [
        np.floor(labels.label(surface.disparity) + 0.5).astype(np.int64)
        for surface in reconstruct(pair.array, labels, jobs=jobs).surfaces
    ]
    measures = evidence(pair.array, labels, maps, 0)
    counted = pair.counted[0]
    bad = np.abs(maps[0] - pair.truth)[counted] > 1.0
    return np.stack([np.asarray(plane)[counted] for plane in measures], axis=1).astype(np.float64), bad


def fitted(samples: Sequence[Sample]) -> Floats:
    """Find the weights of log-odds by logistic regression, all pairs alike."""
    rng = np.random.default_rng(0)
    picked = [rng.choice(len(bad), SAMPLES) for _, bad in samples]
    measures = np.concatenate([one[0][pick] for one, pick in zip(samples, picked, strict=True)])
    good = np.concatenate([~one[1][pick] for one, pick in zip(samples, picked, strict=True)])

    def loss(weights: Floats) -> tuple[float, Floats]:
        odds = measures @ weights
        slope = measures.T @ (1.0 / (1.0 + np.exp(-odds)) - good) / good.size
        return float(np.mean(np.logaddexp(0.0, odds) - good * odds)), slope

    found: Floats = minimize(loss, np.zeros(measures.shape[1]), jac=True).x
    return found


def main(words: Sequence[str] | None = None) -> None:
    """Print a row for each pair, and weights."""
    parser = argparse.ArgumentParser("python -m benchmarks.searches.confidence", description=__doc__)
    add_pair_options(parser)
    arguments = parser.parse_args(words)
    names, pairs = chosen_pairs(arguments)
    samples = [measured(pair, arguments.jobs) for pair in pairs]
    in_use = np.array(WEIGHTS)
    print(f"{'':14} {'no order':>9} {'in use':>9} {'fitted':>9} {'ideal':>9}")
    rows = []
    for number, (name, (measures, bad)) in enumerate(zip(names, samples, strict=True)):
        rest = samples[:number] + samples[number + 1 :]
        areas = [sparsification(bad, measures @ weights) for weights in (in_use, fitted(rest or samples))]
        rows.append([100.0 * float(bad.mean()), areas[0][0], areas[1][0], areas[0][1]])
        print(f"{name:14} " + " ".join(f"{value:9.2f}" for value in rows[-1]), flush=True)
    print(f"{'mean':14} " + " ".join(f"{value:9.2f}" for value in np.mean(rows, axis=0)))
    weights = zip(Evidence._fields, fitted(samples), strict=True)
    print("weights of all: " + ", ".join(f"{name} {value:.2f}" for name, value in weights))


if __name__ == "__main__":
    main()
