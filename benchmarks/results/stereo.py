"""Disparities by `dvc-stereo reconstruct` with its own settings, against the truth and beside OpenCV's."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.results.harness import Measured, Missing, Setting, run_module
from dvc.pfm import read_pfm
from dvc.stereo.opencv_baseline import semi_global_baseline

DATA = Path("..") / "shared" / "stereo"
PAIRS = {
    "tsukuba": ("scene1.row3.col3.png", "scene1.row3.col4.png", "truedisp.row3.col3.png", 16.0, 15),
    "venus": ("im2.png", "im6.png", "disp2.png", 8.0, 20),
    "teddy": ("im2.png", "im6.png", "disp2.png", 4.0, 59),
    "cones": ("im2.png", "im6.png", "disp2.png", 4.0, 59),
}
"""The pairs of the Middlebury evaluation, version 2: both views, truth and its scale, largest disparity."""
OTHERS = ("Aloe", "Baby1", "Bowling2", "Cloth3", "Flowerpots", "Lampshade1", "Midd1", "Rocks1", "Wood2")
"""Pairs of another Middlebury set, below `more`; not all of their pixels have a known disparity."""
_OTHERS_SCALE = 3.0
Floats = NDArray[np.float64]


def data_folder(name: str) -> Path:
    """Return the folder of the real sets, which must have this one."""
    if not (DATA / name).is_dir():
        raise Missing(f"not measured: no folder {DATA / name}")
    return DATA


def _picture(path: Path) -> NDArray[np.uint8]:
    found = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
    if found is None:
        raise Missing(f"not measured: no picture {path}")
    return np.asarray(found, np.uint8)


def _truth(path: Path, scale: float) -> Floats:
    levels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if levels is None:
        raise Missing(f"not measured: no picture {path}")
    levels = levels if levels.ndim == 2 else levels[:, :, 0]
    return np.where(levels == 0, np.nan, levels / scale).astype(np.float64)


def bad_percent(found: NDArray[np.floating], truth: Floats, mask: Path | None) -> float:
    """Return how many pixels are off by more than one pixel, of those that count."""
    counted = np.isfinite(truth)
    if mask is not None and mask.exists():
        counted &= np.asarray(cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE)) == 255
    return 100.0 * float(np.mean(np.abs(found - truth)[counted] > 1.0))


@cache
def _pair(setting: Setting, name: str) -> tuple[float, float]:
    """Return bad pixels of a pair, ours and OpenCV's."""
    if name in PAIRS:
        left, right, truth_name, scale, highest = PAIRS[name]
        folder = DATA / name
    else:
        left, right, truth_name, scale, highest = "im2.png", "im6.png", "disp2.png", _OTHERS_SCALE, 0
        folder = DATA / "more" / name
    truth = _truth(folder / truth_name, scale)
    highest = highest or int(np.ceil(np.nanmax(truth)))
    out = setting.scratch("stereo") / name
    if not (out / f"disparity-{Path(left).stem}.pfm").exists():
        words = ["reconstruct", folder / left, folder / right, f"--disparities=0:{highest}", "--out", out]
        run_module("dvc.stereo", *words, "--jobs", setting.jobs, "--quiet")
    ours = read_pfm(out / f"disparity-{Path(left).stem}.pfm")
    theirs = semi_global_baseline(_picture(folder / left), _picture(folder / right), float(highest))
    mask = folder / "all.png"
    return bad_percent(ours, truth, mask), bad_percent(theirs, truth, mask)


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
