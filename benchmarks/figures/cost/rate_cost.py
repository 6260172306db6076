"""Rate against cost: BD-rates of cheap encoders beside the processor time that they take, in one run."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, partial
from io import BytesIO

from benchmarks.figures.allocation.curves import (
    ANCHOR_QPS,
    FRAMES,
    ONE_WAY,
    QPS,
    TRACKED,
    by_mean_error,
    curve,
    difference,
)
from benchmarks.figures.harness import STATIC_CLIPS, Figure, Measured, Setting, clip_source
from benchmarks.figures.rates import QUICK_FRAMES
from dvc.rd.anchors.codecs import ANCHOR_CODECS
from dvc.rd.anchors.encoding import encode_frames
from dvc.video import Frame, VideoInfo, open_video
from encoder import options

AREA = "cost"
REFERENCE = "x264-ippp"
"""What rates are compared with: x264 medium with motion search and one intra frame."""
PEERS = (
    *("x264-intra", "x264-ultrafast", "x264-superfast", "x264-veryfast", REFERENCE),
    *("x265-ultrafast", "svtav1-fastest"),
)
LABELS = {ONE_WAY: "3D-TE, no feedback", TRACKED: "3D-TE, live"}
"""Codecs of the project; others have the labels of anchors."""
REPETITIONS = 5
Run = Callable[[], object]


@dataclass(frozen=True)
class Material:
    """Grey frames in memory."""

    info: VideoInfo  # their format
    frames: tuple[Frame, ...]  # the frames

    @classmethod
    def read(cls, clip: str, num_frames: int) -> "Material":
        """Read the first frames of a sequence."""
        with open_video(clip_source(clip).path, num_frames=num_frames) as reader:
            return cls(reader.info, tuple(frame.without_chroma() for frame in reader))

    def anchor_run(self, name: str, qp: int) -> Run:
        """Return what codes the frames by a standard codec."""
        size, rate = self.info.size, Fraction(self.info.frame_rate)
        return lambda: list(encode_frames(self.frames, size, rate, ANCHOR_CODECS[name], qp))

    def one_way_run(self, qp: int) -> Run:
        """Return what codes the frames as ``dvc-encode --no-feedback`` does."""
        words = ["video", "stream.dvc", "--no-feedback", "--luma-only", "--qp", str(qp)]
        arguments = options.parser().parse_args(words)

        def _run() -> object:
            stream = BytesIO()
            options.session(arguments, self.info).write(self.frames, stream, lambda _: None)
            return stream

        return _run


def times_ms(runs: Mapping[str, Sequence[Run]], num_frames: int, repetitions: int) -> dict[str, float]:
    """Time encoders in turn, again and again, after each has been run once."""
    each = [(name, run) for name, of_name in runs.items() for run in of_name]
    found: list[list[float]] = [[] for _ in each]
    for turn in range(1 + repetitions):
        for times, (_, run) in zip(found, each, strict=True):
            started = time.process_time()
            run()
            if turn:
                times.append(1000 * (time.process_time() - started) / num_frames)
    medians = [(name, statistics.median(times)) for times, (name, _) in zip(found, each, strict=True)]
    return {name: statistics.fmean(ms for of, ms in medians if of == name) for name in runs}


def label(name: str) -> str:
    """Name a codec."""
    return LABELS.get(name) or ANCHOR_CODECS[name].label


@cache
def _found(setting: Setting, clip: str, names: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """Return time and BD-rates of codecs."""
    material = Material.read(clip, setting.choose(FRAMES, QUICK_FRAMES))
    runs: dict[str, list[Run]] = {}
    for name in names:
        if name == ONE_WAY:
            runs[name] = [material.one_way_run(qp) for qp in QPS[:: setting.choose(1, 3)]]
        else:
            runs[name] = [material.anchor_run(name, qp) for qp in ANCHOR_QPS[:: setting.choose(1, 4)]]
    cost_ms = times_ms(runs, len(material.frames), setting.choose(REPETITIONS, 1))
    return {name: {"cost_ms": cost_ms[name]} | _bd_rates(setting, clip, name) for name in names}


def _bd_rates(setting: Setting, clip: str, name: str) -> dict[str, float]:
    """Return BD-rates by the mean of PSNRs, and by the PSNR of the mean squared error."""
    if name == REFERENCE:
        return {"bd_rate_percent": 0.0, "bd_rate_mse_percent": 0.0}
    curves = curve(setting, clip, REFERENCE), curve(setting, clip, name)
    by_mse = difference(*map(by_mean_error, curves)).value
    return {"bd_rate_percent": difference(*curves).value, "bd_rate_mse_percent": by_mse}


def _text(found: Mapping[str, Mapping[str, float]]) -> str:
    parts = [
        f"{label(name)} {one['cost_ms']:.2f} ms {one['bd_rate_percent']:+.0f} %"
        for name, one in sorted(found.items(), key=lambda item: item[1]["cost_ms"])
    ]
    return ", ".join(parts)


def rate_cost(setting: Setting, clip: str, names: tuple[str, ...]) -> Measured:
    """Measure BD-rate and processor time of cheap encoders."""
    found = _found(setting, clip, names)
    return Measured(_text(found), None, {"codecs": found})


def mean_rate_cost(setting: Setting, clip: str, names: tuple[str, ...]) -> Measured:
    """Average rate and cost over the real clips of static scenes."""
    del clip
    clips = STATIC_CLIPS[: setting.choose(len(STATIC_CLIPS), 1)]
    each = [_found(setting, one, names) for one in clips]
    means = {
        name: {key: statistics.fmean(found[name][key] for found in each) for key in each[0][name]}
        for name in names
    }
    return Measured(_text(means), None, {"codecs": means, "num_clips": len(each)})


_TITLE = "processor time of encoding a frame and BD-rate against x264 medium, 49 frames: {}"
_MEAN = "the same, mean over these"
_TRUE = "the true figure"
_GROUPS = {
    "rate-cost": ("--no-feedback, standard codecs", (*PEERS, ONE_WAY)),
    "rate-cost-standard": ("standard codecs", PEERS),
}
FIGURES = tuple(
    figure
    for end, (words, names) in _GROUPS.items()
    for figure in (
        Figure(AREA, end, _TITLE.format(words), _TRUE, partial(rate_cost, names=names), STATIC_CLIPS),
        Figure(AREA, f"{end}-mean", _MEAN, _TRUE, partial(mean_rate_cost, names=names)),
    )
)
"""The figures of this module."""
