"""Disparities against the truth: the Middlebury sets, more cameras, sub-pixel, OpenCV beside them."""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.stereo.runs import (
    MOTORCYCLE,
    MOTORCYCLE_DISPARITIES,
    data_folder,
    motorcycle,
    reconstruction_folder,
    reference_disparity,
    write_pair,
)
from dvc.pfm import read_pfm
from dvc.stereo.evaluation import evaluate
from dvc.stereo.thesis.opencv_baseline import BASELINE, semi_global_baseline
from dvc.stereo.thesis.real_sets import ANTINOUS, PAIRS, TSUKUBA

AREA = "stereo"
ASKED = {"tsukuba": 1.5, "venus": 1.0, "teddy": 9.0, "cones": 8.0}
THESIS = {"tsukuba": 1.53, "venus": 1.04, "teddy": 10.9, "cones": 8.65}
ASKED_CAMERAS = {2: 1.5, 5: 1.3, 25: 1.2}
THESIS_CAMERAS = {2: 1.5, 5: 1.3, 25: 1.3}
MOST_OF_BASELINE = 0.65
SUB_PIXEL_PX = 0.07, 0.03
SUB_PIXEL_OPTIONS = ("--sub-pixel", "--iterations", 2, "--jobs", 2)
"""The third iteration would change nothing that the figure shows, and take as long as the second."""


def bad_pixels(setting: Setting, clip: str, name: str) -> Measured:
    """Evaluate a pair of the Middlebury evaluation with the default settings."""
    del setting, clip
    one = PAIRS[name]
    found = one.evaluate(data_folder(name), reference_disparity(one), (0.5, 1.0, 2.0))
    bad = {mask: result.bad_percent[1.0] for mask, result in found.items()}
    text = f"{bad['all']:.2f} % (not occluded {bad['nonocc']:.2f}, near discontinuities {bad['disc']:.2f})"
    values = {mask: result.to_dict() for mask, result in found.items()}
    return Measured(text, bad["all"] <= ASKED[name], values)


def _pair(name: str) -> tuple[dict[str, float], dict[str, float]]:
    """Return bad pixels by mask, ours and OpenCV's."""
    if name == MOTORCYCLE:
        left, right, truth = motorcycle()
        with tempfile.TemporaryDirectory() as scratch:
            paths = write_pair(Path(scratch), left, right)
            with reconstruction_folder(paths, MOTORCYCLE_DISPARITIES) as (folder, _):
                ours = read_pfm(folder / "disparity-left.pfm")
        theirs = semi_global_baseline(left, right, float(MOTORCYCLE_DISPARITIES.split(":")[1]) - 1.0)
        bad = [evaluate(found, truth).bad_percent[1.0] for found in (ours, theirs)]
        return {"all": bad[0]}, {"all": bad[1]}
    one = PAIRS[name]
    data = data_folder(name)
    array = one.pair(data)
    theirs = semi_global_baseline(array[0].image, array[1].image, one.labels.highest)
    both = [one.evaluate(data, found) for found in (reference_disparity(one), theirs)]
    ours_bad, theirs_bad = (
        {mask: result.bad_percent[1.0] for mask, result in found.items()} for found in both
    )
    return ours_bad, theirs_bad


def against_opencv(setting: Setting, clip: str) -> Measured:
    """Compare with the semi-global matching of OpenCV on the same pairs in the same run."""
    del clip
    names = (*PAIRS, MOTORCYCLE)[: setting.choose(len(PAIRS) + 1, 1)]
    found = {name: _pair(name) for name in names}
    ratio, not_occluded = (_ratio_of_means(found, mask) for mask in ("all", "nonocc"))
    each = ", ".join(f"{name} {pair[0]['all']:.1f}/{pair[1]['all']:.1f}" for name, pair in found.items())
    bad = {name: list(pair) for name, pair in found.items()}
    values = {"ratio": ratio, "ratio_nonocc": not_occluded, "bad_percent": bad}
    text = f"{ratio:.2f} ({each} %); not occluded {not_occluded:.2f}"
    return Measured(text, max(ratio, not_occluded) <= MOST_OF_BASELINE, values, str(BASELINE))


def _ratio_of_means(found: dict[str, tuple[dict[str, float], dict[str, float]]], mask: str) -> float:
    known = [pair for pair in found.values() if mask in pair[0]]
    ours, theirs = (float(np.mean([pair[side][mask] for pair in known])) for side in (0, 1))
    return ours / theirs


def more_cameras(setting: Setting, clip: str, num_cameras: int) -> Measured:
    """Evaluate Tsukuba with cameras around the reference, as table 2.2."""
    del setting, clip
    found = TSUKUBA.evaluate(data_folder("tsukuba"), reference_disparity(TSUKUBA, num_cameras))
    bad = {mask: result.bad_percent[1.0] for mask, result in found.items()}
    return Measured(f"{bad['all']:.2f} %", bad["all"] <= ASKED_CAMERAS[num_cameras], bad)


def sub_pixel(setting: Setting, clip: str) -> Measured:
    """Evaluate antinous, whose true disparities are not whole numbers."""
    del clip
    data = data_folder("antinous")
    found = {}
    for num_cameras in (2, 5, 25)[: setting.choose(3, 1)]:
        disparity = reference_disparity(ANTINOUS, num_cameras, SUB_PIXEL_OPTIONS)
        found[num_cameras] = ANTINOUS.evaluate(data, disparity, SUB_PIXEL_PX)["all"]
    errors = {cameras: result.mean_absolute_error_px or 0.0 for cameras, result in found.items()}
    last = found[max(found)]
    beyond = ", ".join(f"{percent:.1f} % > {limit:g} px" for limit, percent in last.bad_percent.items())
    each = ", ".join(f"{cameras}: {error:.3f}" for cameras, error in errors.items())
    values = {str(cameras): result.to_dict() for cameras, result in found.items()}
    return Measured(f"{errors[max(found)]:.3f} px, {beyond} (by cameras {each})", _falls(errors), values)


def _falls(errors: dict[int, float]) -> bool:
    return all(errors[max(errors)] < error for cameras, error in errors.items() if cameras != max(errors))


FIGURES = (
    *(
        Figure(
            AREA,
            f"bad-pixels-{name}",
            f"bad pixels > 1 px, all, {name}, two views",
            f"≤ {ASKED[name]:g} %",
            partial(bad_pixels, name=name),
            thesis=f"{THESIS[name]:g} %",
        )
        for name in PAIRS
    ),
    Figure(
        AREA,
        "against-opencv",
        "bad pixels > 1 px, all and not occluded, over StereoSGBM's with holes filled, means of five pairs",
        f"≤ {MOST_OF_BASELINE} each",
        against_opencv,
    ),
    *(
        Figure(
            AREA,
            f"tsukuba-{cameras}-cameras",
            f"bad pixels > 1 px, all, Tsukuba with {cameras} cameras (table 2.2)",
            f"≤ {ASKED_CAMERAS[cameras]} %",
            partial(more_cameras, num_cameras=cameras),
            thesis=f"{THESIS_CAMERAS[cameras]} %",
            slow=cameras == 25,
        )
        for cameras in ASKED_CAMERAS
    ),
    Figure(
        AREA,
        "antinous",
        "antinous, 25 cameras: mean absolute error, pixels beyond 0.07 and 0.03 px",
        "below those with 2 and 5 cameras",
        sub_pixel,
    ),
)
"""The figures of this module."""
