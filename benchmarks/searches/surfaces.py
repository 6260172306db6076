"""Settings of a reconstruction: bad pixels of pairs with known disparities, and those of StereoSGBM.

``python -m benchmarks.searches.surfaces [--pairs teddy Baby1] [--set sub_pixel=True] [--halve]``
reconstructs pairs below ``../shared/stereo`` with default or changed settings: fields of `StereoSettings`,
and constants of modules by their full names. A row has the share that is off by more than 1 and 0.5 px, of
all pixels and of those that both views see, ours and that of StereoSGBM with the one of `GRID` that is best
on all these pairs; the last rows the ratio of the means and the geometric mean of ratios. The settings were
chosen on `TUNING_PAIRS`; ``--pairs test`` selects the test pairs.
"""

import argparse
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import fields, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.opencv_stereo import SemiGlobalSettings, semi_global_baseline
from benchmarks.thesis.scenes import PAIRS, RealSet
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels
from dvc.stereo.evaluation import read_mask, read_truth
from dvc.stereo.surfaces.reconstruct import reconstruct
from dvc.stereo.surfaces.stereo_settings import StereoSettings

DATA = Path("..") / "shared" / "stereo"
SCALES = {"barn1": 8.0, "bull": 8.0, "sawtooth": 8.0}
THRESHOLDS_PX = 1.0, 0.5
TUNING_PAIRS = (
    *("tsukuba", "venus", "teddy", "cones"),
    *("Adirondack_Q", "Baby1", "Bowling2", "Flowerpots", "Lampshade1"),
    *("Monopoly", "Playroom_Q", "Rocks1", "barn1", "sawtooth"),
)
TEST_PAIRS = "Aloe", "Cloth3", "Midd1", "Pipes_Q", "Recycle_Q", "Wood2", "bull"
"""Pairs of Middlebury for the choice of settings, and for the comparison of several trials."""
GRID = [
    SemiGlobalSettings(size, first * size**2, second * size**2, uniqueness_ratio=unique)
    for size, (first, second), unique in product((3, 5, 7), ((24, 96), (12, 200), (24, 200)), (0, 10))
]
"""Settings of StereoSGBM that are tried."""
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Pair(NamedTuple):
    """Two views, and the truth of the left one."""

    array: CameraArray
    truth: Floats  # disparity; NaN: unknown
    counted: tuple[Mask, Mask]  # all pixels that count, and those of them that both views see

    @property
    def highest(self) -> int:
        """The largest disparity to try."""
        return int(np.ceil(np.nanmax(self.truth)))

    def bad_percent(self, disparity: NDArray[np.floating]) -> list[float]:
        """Return the share of wrong pixels by each threshold, of all and of those that both views see."""
        off = np.abs(disparity - self.truth)
        return [
            100.0 * float(np.mean(off[mask] > threshold))
            for threshold, mask in product(THRESHOLDS_PX, self.counted)
        ]


def read_pair(name: str) -> Pair:
    """Read a pair by the name of its folder."""
    if name in PAIRS:
        one = PAIRS[name]
        masks = [read_mask(DATA / name / f"{kind}.png") for kind in ("all", "nonocc")]
        truth = one.true_disparity(DATA)
    else:
        scale = 256.0 if name.endswith("_Q") else SCALES.get(name, 3.0)
        one = RealSet(f"more/{name}", "im2.png", "im6.png", "", "disp2.png", scale)
        truth, folder = one.true_disparity(DATA), DATA / "more" / name
        if (folder / "disp6.png").exists():
            seen = seen_by_both(truth, read_truth(folder / "disp6.png", scale))
        else:
            seen = read_mask(folder / "mask0nocc.png")
        masks = [np.ones(truth.shape, np.bool_), seen]
    known = np.isfinite(truth)
    return Pair(one.pair(DATA), truth, (masks[0] & known, masks[1] & known))


def seen_by_both(truth: Floats, right: Floats) -> Mask:
    """Return a mask of the pixels of the left view that the right one shows: their disparities agree."""
    columns, known = np.arange(truth.shape[1]), np.isfinite(truth)
    there = np.rint(columns - np.where(known, truth, np.inf).clip(max=1e6)).astype(np.int64)
    inside = known & (there >= 0)
    found = np.take_along_axis(right, np.where(inside, there, 0), axis=1)
    seen: Mask = inside & (np.abs(found - truth) <= 1.0)
    return seen


def halved(pair: Pair) -> Pair:
    """Return a pair of half the size."""
    height, width = pair.truth.shape
    size = width // 2, height // 2
    views = [
        ArrayView(view.name, _area(view.image, size).astype(np.uint8), view.position) for view in pair.array
    ]
    rows, columns = slice(0, 2 * size[1], 2), slice(0, 2 * size[0], 2)
    first, second = (mask[rows, columns] for mask in pair.counted)
    return Pair(CameraArray(tuple(views)), pair.truth[rows, columns] / 2.0, (first, second))


def _area(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[Any]:
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def best_baseline(pairs: Sequence[Pair]) -> tuple[SemiGlobalSettings, list[list[float]]]:
    """Return the settings of StereoSGBM with the fewest bad pixels, and their bad pixels of each pair."""

    def bad(pair: Pair, settings: SemiGlobalSettings) -> list[float]:
        left, right = (view.image for view in pair.array)
        return pair.bad_percent(semi_global_baseline(left, right, float(pair.highest), settings))

    found = [[bad(pair, settings) for pair in pairs] for settings in GRID]
    best = int(np.argmin([np.mean(own, axis=0)[:2].sum() for own in found]))
    return GRID[best], found[best]


def changed(given: Sequence[str], stack: ExitStack) -> StereoSettings:
    """Return settings with some fields changed, and change constants as long as the stack is open."""
    usual, values = StereoSettings(), dict[str, Any]()
    for one in given:
        name, _, text = one.partition("=")
        if name in {field.name for field in fields(StereoSettings)}:
            values[name] = _value(text, getattr(usual, name))
        else:
            module, _, constant = name.rpartition(".")
            own = getattr(__import__(module, fromlist=[constant]), constant)
            stack.enter_context(mock.patch(name, _value(text, own)))
    return replace(usual, **values)


def _value(text: str, usual: Any) -> Any:
    return text == "True" if isinstance(usual, bool) else type(usual)(text)


def row(name: str, ours: Sequence[float], theirs: Sequence[float], end: str = "") -> str:
    """Return a line of a pair."""
    numbers = " ".join(f"{own:6.2f} {other:6.2f}" for own, other in zip(ours, theirs, strict=True))
    return f"{name:14} {numbers} {end}"


def summary(ours: Sequence[Sequence[float]], theirs: Sequence[Sequence[float]]) -> list[str]:
    """Return lines of means and of ratios."""
    own, other = np.array(ours), np.array(theirs)
    means = own.mean(axis=0), other.mean(axis=0)
    ratios = means[0] / means[1], np.exp(np.log(own / other).mean(axis=0))
    kinds = "ratio of means", "mean of ratios"
    return [row("mean", *means)] + [
        f"{kind:14} " + " ".join(f"{value:13.3f}" for value in ratio)
        for kind, ratio in zip(kinds, ratios, strict=True)
    ]


def add_pair_options(parser: argparse.ArgumentParser) -> None:
    """Add options that select pairs."""
    parser.add_argument("--pairs", nargs="+", default=list(TUNING_PAIRS), metavar="NAME")
    parser.add_argument("--halve", action="store_true", help="pairs of half the size: quicker")
    parser.add_argument("--jobs", type=int, default=2)


def chosen_pairs(arguments: argparse.Namespace) -> tuple[list[str], list[Pair]]:
    """Return the selected pairs and their names."""
    names = list(TEST_PAIRS) if arguments.pairs == ["test"] else arguments.pairs
    return names, [halved(read_pair(name)) if arguments.halve else read_pair(name) for name in names]


def main(words: Sequence[str] | None = None) -> None:
    """Print a row for each pair."""
    parser = argparse.ArgumentParser("python -m benchmarks.searches.surfaces", description=__doc__)
    add_pair_options(parser)
    parser.add_argument("--set", nargs="*", default=[], metavar="FIELD=VALUE")
    arguments = parser.parse_args(words)
    names, pairs = chosen_pairs(arguments)
    baseline, theirs = best_baseline(pairs)
    print(f"{baseline}\n{'':14} {'>1 all':>13} {'>1 seen':>13} {'>.5 all':>13} {'>.5 seen':>13}", flush=True)
    ours = []
    with ExitStack() as stack:
        settings = changed(arguments.set, stack)
        for name, pair, other in zip(names, pairs, theirs, strict=True):
            started = time.perf_counter()
            labels = DisparityLabels(0.0, 1.0, pair.highest + 1)
            found = reconstruct(pair.array, labels, settings, jobs=arguments.jobs)
            ours.append(pair.bad_percent(found.surfaces[0].disparity))
            print(row(name, ours[-1], other, f"{time.perf_counter() - started:5.1f} s"), flush=True)
    print("\n".join(summary(ours, theirs)))


if __name__ == "__main__":
    main()
