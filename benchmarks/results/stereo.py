"""Disparities of `dvc-stereo reconstruct` with its default settings and of OpenCV, against the truth."""

from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.baselines.opencv_stereo import semi_global_baseline
from benchmarks.results.harness import Measured, Missing, Setting, run_module
from benchmarks.thesis.scenes import PAIRS, RealSet
from dvc.picture_files import read_pfm

DATA = Path("..") / "shared" / "stereo"
OTHERS = ("Aloe", "Baby1", "Bowling2", "Cloth3", "Flowerpots", "Lampshade1", "Midd1", "Rocks1", "Wood2")
"""Pairs of another Middlebury set, in `more`; the disparity of some of their pixels is unknown."""
_OTHERS_SCALE = 3.0


def data_folder(name: str) -> Path:
    """Return the folder of the real sets if it has a set."""
    if not (DATA / name).is_dir():
        raise Missing(f"not measured: no folder {DATA / name}")
    return DATA


@cache
def _pair(setting: Setting, name: str) -> tuple[float, float]:
    """Return bad pixels of a pair, ours and OpenCV's."""
    real_set, data = PAIRS.get(name), DATA
    if real_set is None:
        real_set, data = RealSet(name, "im2.png", "im6.png", "", "disp2.png", _OTHERS_SCALE), DATA / "more"
    if not (data / name).is_dir():
        raise Missing(f"not measured: no folder {data / name}")
    truth = real_set.true_disparity(data)
    highest = round(real_set.labels.highest) if real_set.disparities else int(np.ceil(np.nanmax(truth)))
    out, files = setting.scratch("stereo") / name, real_set.pair_files(data)
    if not (out / f"disparity-{files[0].stem}.pfm").exists():
        words = ["reconstruct", *files, f"--disparities=0:{highest}", "--out", out]
        run_module("dvc.stereo", *words, "--jobs", setting.jobs, "--quiet")
    left, right = (view.image for view in real_set.pair(data))
    both = read_pfm(out / f"disparity-{files[0].stem}.pfm"), semi_global_baseline(left, right, float(highest))
    ours, baseline = (real_set.evaluate(data, disparity)["all"].bad_percent[1.0] for disparity in both)
    return ours, baseline


def bad_pixels(setting: Setting, name: str) -> Measured:
    """Evaluate one pair."""
    return Measured(_pair(setting, name)[0])


def over_baseline(setting: Setting, names: tuple[str, ...]) -> Measured:
    """Compare the mean of bad pixels over pairs with that of StereoSGBM."""
    chosen = names[: setting.choose(len(names), 1)]
    found = {name: _pair(setting, name) for name in chosen}
    ours, theirs = (float(np.mean([pair[side] for pair in found.values()])) for side in (0, 1))
    ratios = {name: own / other for name, (own, other) in found.items()}
    return Measured(ours / theirs, ratios, None, f"{ours:.2f} % against {theirs:.2f} %")
