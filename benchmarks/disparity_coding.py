"""Disparities coded with texture on pairs of photographs: L and S compared with quadtrees of the same search.

``python -m benchmarks.disparity_coding [--pairs teddy Aloe] [--quick]`` codes pairs below
``../shared/stereo`` at the rates of chapter 3 and prints, for L and for S, the mean gain in PSNR of the
rendered views over the quadtree, the change of rate at equal PSNR, and its lowest and highest PSNR.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from benchmarks.searches.surfaces import read_pair
from benchmarks.thesis.harness import Method
from benchmarks.thesis.scenes import scene_of_array
from benchmarks.thesis.view_curves import (
    CODERS,
    QUICK_BPP,
    REFERENCE_BPP,
    curve,
    differences,
    reference_multipliers,
)
from dvc.geometry.camera_array import DisparityLabels

PAIRS = "teddy", "tsukuba", "cones", "Aloe", "Baby1", "Bowling2", "Rocks1", "Wood2"
METHODS = "l", "s", "quadtree"


def row(name: str, rates_bpp: tuple[float, ...]) -> list[float]:
    """Return gains in dB and per cent of L, then of S, and the ends of both curves."""
    pair = read_pair(name)
    scene = scene_of_array(pair.array, DisparityLabels(0.0, 1.0, pair.highest + 1))
    multipliers = reference_multipliers(scene.views, rates_bpp)
    curves = [
        curve(scene.views, scene.labels, CODERS[Method.DEFAULT][method], multipliers) for method in METHODS
    ]
    found = list[float]()
    for own in curves[:2]:
        found += differences(own, curves[2]) or (np.nan, np.nan)
    return found + [end(point.quality.pooled_db for point in own) for own in curves[:2] for end in (min, max)]


def main(words: Sequence[str] | None = None) -> None:
    """Print a row for each pair."""
    parser = argparse.ArgumentParser("python -m benchmarks.disparity_coding", description=__doc__)
    parser.add_argument("--pairs", nargs="+", default=list(PAIRS), metavar="NAME")
    parser.add_argument("--quick", action="store_true", help="at fewer rates")
    arguments = parser.parse_args(words)
    print(f"{'':10} {'L dB':>7} {'L %':>7} {'S dB':>7} {'S %':>7}   {'PSNR of L':>13}   {'PSNR of S':>13}")
    rows = []
    for name in arguments.pairs:
        rows.append(row(name, QUICK_BPP if arguments.quick else REFERENCE_BPP))
        print(f"{name:10} " + " ".join(f"{value:7.2f}" for value in rows[-1]), flush=True)
    print(f"{'mean':10} " + " ".join(f"{value:7.2f}" for value in np.mean(rows, axis=0)))


if __name__ == "__main__":
    main()
