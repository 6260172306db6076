"""Rate-distortion curves of the headline results: sweeps of `dvc-rd`, which serve many results each."""

import statistics
import subprocess
from collections.abc import Callable
from functools import cache

from benchmarks.results.harness import Measured, Missing, Setting, mean_of
from dvc.environment import child_environment, python_module
from dvc.errors import DvcError
from dvc.rd.anchors import ANCHOR_CODECS
from dvc.rd.rd_curves import ANCHOR_LABEL, Curve, Measure, compare_curves, experiments
from dvc.rd.rd_results import PointResult, read_results
from dvc.rd.specification import ANCHORS

FRAMES, QUICK_FRAMES = 49, 9
"""One intra frame and 48 more: with fewer, the key frames of a group weigh too much or too little."""
QPS, FEW_QPS, PROVEN_QP = (24, 28, 32, 36), (24, 30, 36), 36
QUICK_QPS = (28, 36)
ANCHOR_QPS = (20, 24, 28, 32, 36, 42)
DEFAULT, LUMA_ONLY = "default", "luma-only"
CODECS: dict[str, tuple[str, ...]] = {
    "2d": ("--codec", "2d"),
    "no-feedback": ("--no-feedback",),
    LUMA_ONLY: ("--luma-only",),
}
"""Options of `dvc-rd run` except qualities, by the name of the folder."""
MATRICES, QUICK_MATRICES = (1, 3, 5), (1, 3)
"""DISCOVER quantisation matrices that reach the PSNRs of `QPS`."""
_OF_LUMA = (LUMA_ONLY, "matrices", "scene", "block-motion")
"""Folders of streams without chroma; the rest are in colour."""


def frames(setting: Setting) -> int:
    """Return the number of frames of each clip."""
    return int(setting.choose(FRAMES, QUICK_FRAMES))


def _numbers(values: tuple[int, ...]) -> str:
    return ",".join(map(str, values))


def run_sweep(setting: Setting, clips: list[str], name: str, *options: str, num_frames: int) -> None:
    """Measure points by `dvc-rd run`; those that are there, of this code, are kept."""
    command = python_module("dvc.rd", "run", *clips, "--frames", num_frames, *options)
    command += ["--out", str(setting.scratch(name)), "--jobs", str(setting.jobs)]
    if subprocess.run(command, env=child_environment(), check=False).returncode != 0:
        raise DvcError(f"some points of {name} could not be measured; see above")


@cache
def sweep(setting: Setting, name: str, anchor: str | None = None) -> dict[str, Curve]:
    """Measure the curve of a codec, or of an anchor, on every clip."""
    clips, count = setting.clips(), frames(setting)
    if anchor is not None:
        qps = setting.choose(ANCHOR_QPS, ANCHOR_QPS[1::2])
        words = ["--qp", str(PROVEN_QP), "--anchor", anchor, "--anchor-qp", _numbers(qps)]
        run_sweep(setting, clips, name, *words, num_frames=count)
    elif name == "matrices":
        matrices = _numbers(setting.choose(MATRICES, QUICK_MATRICES))
        words = ["--wz-q", matrices, "--luma-only", "--no-proof"]
        run_sweep(setting, clips, name, *words, num_frames=count)
    elif name == DEFAULT:
        qps = tuple(qp for qp in setting.choose(QPS, QUICK_QPS) if qp != PROVEN_QP)
        run_sweep(setting, clips, name, "--qp", _numbers(qps), "--no-proof", num_frames=count)
        run_sweep(setting, clips, name, "--qp", str(PROVEN_QP), num_frames=count)
    else:
        words = [*CODECS[name], "--qp", _numbers(setting.choose(FEW_QPS, QUICK_QPS)), "--no-proof"]
        run_sweep(setting, clips, name, *words, num_frames=count)
    return curves_in(setting, name, clips, count, anchor)


def curves_in(
    setting: Setting, name: str, clips: list[str], num_frames: int, anchor: str | None = None
) -> dict[str, Curve]:
    """Read the curves of a folder, by clip."""
    label = None
    if anchor is not None:
        label = ANCHOR_LABEL if anchor == "intra" else ANCHOR_CODECS[ANCHORS[anchor]].label
    found = {}
    for one in experiments(read_results(setting.scratch(name))):
        clip = one.curves[0].points[0].sequence.name
        matching = [
            curve for curve in one.curves if (not curve.is_anchor if label is None else curve.label == label)
        ]
        if clip in clips and one.key[2:] == (num_frames, name in _OF_LUMA) and matching:
            found[clip] = matching[0]
    if missing := set(clips) - set(found):
        raise Missing(f"{name}: no curve of {', '.join(sorted(missing))}")
    return found


def bd_rates(
    reference: dict[str, Curve], other: dict[str, Curve], measure: Measure = "luma"
) -> dict[str, float]:
    """Return BD-rates in percent, by clip."""
    found = {}
    for clip, curve in other.items():
        difference = compare_curves(reference[clip], curve, "rate", measure)
        if isinstance(difference, str):
            raise DvcError(f"{clip}: {difference}")
        found[clip] = difference.value
    return found


def against_anchor(setting: Setting, anchor: str, name: str = DEFAULT, measure: Measure = "luma") -> Measured:
    """Compare with a standard codec on the same frames."""
    codec = sweep(setting, name)
    reference = sweep(setting, DEFAULT, anchor)
    return mean_of(bd_rates(reference, codec, measure), frames(setting))


def against_codec(setting: Setting, reference: str, name: str = DEFAULT) -> Measured:
    """Compare with another codec of the project, or another way to run it."""
    codec = sweep(setting, name)
    return mean_of(bd_rates(sweep(setting, reference), codec), frames(setting))


def of_points(setting: Setting, number: Callable[[PointResult], float], note: str = "") -> Measured:
    """Average a number over the points of the default codec, then over clips."""
    curves = sweep(setting, DEFAULT)
    by_clip = {clip: statistics.fmean(map(number, curve.points)) for clip, curve in curves.items()}
    return mean_of(by_clip, frames(setting), note)


def parity_over_ideal(setting: Setting) -> Measured:
    """Compare all check and parity bits with the ideal code length of the decoder's own probabilities."""
    return of_points(setting, lambda point: float(point.totals.plane_bits["all"]["ratio"]))


def decoding_cpu_s(setting: Setting) -> Measured:
    """Take processor time of the decoder for each Wyner-Ziv frame, start of the process included."""
    return of_points(setting, lambda point: (point.times.decode_cpu_s or 0.0) / point.num_frames("wz"))


def requests_per_frame(setting: Setting) -> Measured:
    """Count the requests of the decoder."""
    return of_points(setting, lambda point: (point.totals.num_requests or 0.0) / point.num_frames("wz"))


def worst_frame_db(setting: Setting) -> Measured:
    """Return the PSNR of the worst frame below the mean, at the worst quality of each clip."""
    below = {
        clip: max(point.psnr_y_db - (point.totals.worst_psnr_y_db or 0.0) for point in curve.points)
        for clip, curve in sweep(setting, DEFAULT).items()
    }
    return mean_of(below, frames(setting))


def not_proven(setting: Setting) -> Measured:
    """Count clips with a punctured stream that a fresh process decodes to other frames; such points fail."""
    curves = sweep(setting, DEFAULT).values()
    unproven = sum(not any(point.is_proven for point in curve.points) for curve in curves)
    return Measured(float(unproven), {}, frames(setting))


SIDE_INFORMATION_FRAMES = 33
_SIDE_INFORMATION = ("--wz-q", "1", "--key-qp", "lossless", "--option", "references=keys", "--no-proof")


def side_information_gain(setting: Setting) -> Measured:
    """Predict the same frames from the same lossless key frames, by the scene and by block motion."""
    clips, count = setting.clips(), int(setting.choose(SIDE_INFORMATION_FRAMES, QUICK_FRAMES))
    for name, method in (("scene", None), ("block-motion", "mci")):
        words = [] if method is None else ["--side-information", method]
        run_sweep(setting, clips, name, *_SIDE_INFORMATION, "--luma-only", *words, num_frames=count)
    scene, blocks = (
        {clip: curve.points[0].totals.si_psnr_y_db or 0.0 for clip, curve in curves.items()}
        for curves in (curves_in(setting, name, clips, count) for name in ("scene", "block-motion"))
    )
    return mean_of({clip: scene[clip] - blocks[clip] for clip in clips}, count)
