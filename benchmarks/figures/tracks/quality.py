"""Side information by tracked points against 2D block motion, and its motion models against each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from benchmarks.figures.harness import SCENES, STATIC_CLIPS, Figure, Measured, Setting, mean_over_clips
from benchmarks.figures.tracks.points import Quality, quality
from benchmarks.figures.tracks.runs import (
    BLOCK_MOTION,
    FAST_CLIPS,
    FIXED_GOP,
    TD_DEPTH,
    TE_BLOCKS,
    TE_DEPTH,
    TE_MESH,
    Run,
    Way,
)

AREA = "tracks"
REAL_CLIPS = (*STATIC_CLIPS, "cube")
QUICK_FRAMES = 9


@dataclass(frozen=True)
class Comparison:
    """Two ways to predict the same frames from the same key frames."""

    baseline: Way  # the ways
    other: Way
    adaptive: bool = False  # whether the tracks choose the key frames; otherwise they are at a fixed distance

    def runs(self, setting: Setting, clip: str) -> tuple[Run, Run]:
        """Return both runs on a clip."""
        frames = setting.choose(setting.frames, QUICK_FRAMES)
        gop = None if self.adaptive else fixed_gop(clip)
        return Run(clip, self.baseline, frames, gop), Run(clip, self.other, frames, gop)

    def measure(self, setting: Setting, clip: str) -> tuple[Quality, Quality]:
        """Return the side information of both."""
        first, second = self.runs(setting, clip)
        return quality(setting, first), quality(setting, second)


TE_ADAPTIVE = Comparison(BLOCK_MOTION, TE_DEPTH, adaptive=True)
TE_FIXED = Comparison(BLOCK_MOTION, TE_DEPTH)
TD_FIXED = Comparison(BLOCK_MOTION, TD_DEPTH)
BLOCKS_TO_DEPTH = Comparison(TE_BLOCKS, TE_DEPTH)
BLOCKS_TO_MESH = Comparison(TE_BLOCKS, TE_MESH)


def fixed_gop(clip: str) -> int:
    """Return the fixed distance of key frames at which a clip is measured."""
    return FAST_CLIPS.get(clip, FIXED_GOP)


def gain(setting: Setting, clip: str, comparison: Comparison, least_db: float | None) -> Measured:
    """Compare two ways on one clip."""
    first, second = comparison.measure(setting, clip)
    gained_db, served, count = second.mean_db - first.mean_db, second.num_served, second.num_frames
    text = f"{gained_db:+.2f} dB ({first.mean_db:.2f} → {second.mean_db:.2f}"
    text += ")" if served == count else f"; the scene served {served} of {count} frames)"
    values = {
        "baseline_db": first.mean_db,
        "other_db": second.mean_db,
        "num_served": served,
        "num_frames": count,
    }
    return Measured(text, None if least_db is None else gained_db >= least_db, values)


def mean_gain(
    setting: Setting, clip: str, comparison: Comparison, clips: Sequence[str], least_db: float
) -> Measured:
    """Average the difference of two ways over clips."""
    del clip

    def difference(name: str) -> float:
        first, second = comparison.measure(setting, name)
        return second.mean_db - first.mean_db

    return mean_over_clips(
        setting,
        clips,
        difference,
        "{:+.2f} dB",
        lambda mean: mean >= least_db if least_db else mean > 0,
    )


_TE_ADAPTIVE = "TE (depth) against our 2D, lossless keys that the tracks choose, all frames, mean PSNR"
_TE_FIXED = "TE (depth) against our 2D, lossless keys, GOP 10 (stone 2)"
_TD = "TD (depth) against our 2D, lossless keys, GOP 10 (stone 2)"
_DEPTH = "depth against blocks, TE, lossless keys, GOP 10 (stone 2)"
_BOTH = (
    "depths from two costs, in the order of rigid motions, against one from gradients, TE, lossless keys, "
)
_BOTH += "GOP 10 (stone 2)"
_MESH = "mesh of the thesis against blocks, TE, lossless keys, GOP 10"
_NOT_BELOW = "no clip below 2D"
_RIGID = (*STATIC_CLIPS, *SCENES)
_WHOLE_PIXELS = Way("3d-te", "depth", subpixel_bits=0)
_OPTIONS = {
    "fused": ("`--side-information fused` in place of depth", TE_DEPTH, Way("3d-te", "fused")),
    "corrections": ("`--track-corrections`", TE_DEPTH, Way("3d-te", "depth", track_corrections=True)),
    "regularity": ("`--path-regularity 0.03`", TE_DEPTH, Way("3d-te", "depth", path_regularity=0.03)),
    "subpixel": ("`--subpixel 1` (the default) in place of whole pixels", _WHOLE_PIXELS, TE_DEPTH),
}
"""What options that are off by default do, the way without each, and the way with it."""


def _option_figures(name: str) -> tuple[Figure, Figure]:
    """Return the rows of an option: one per clip, and the mean."""
    what, baseline, other = _OPTIONS[name]
    comparison = Comparison(baseline, other)
    title = f"{what}: PSNR of the side information, TE, lossless keys, GOP 10 (stone 2)"
    each = partial(gain, comparison=comparison, least_db=None)
    mean = partial(mean_gain, comparison=comparison, clips=_RIGID, least_db=0.0)
    return (
        Figure(AREA, f"option-{name}", title, "the true figure", each, _RIGID),
        Figure(AREA, f"option-{name}-mean", "the same, mean over static clips and scenes", "> 0 dB", mean),
    )


FIGURES = (
    Figure(
        AREA, "te", _TE_ADAPTIVE, _NOT_BELOW, partial(gain, comparison=TE_ADAPTIVE, least_db=0.0), REAL_CLIPS
    ),
    Figure(
        AREA,
        "te-scenes",
        _TE_ADAPTIVE,
        "≥ +5 dB",
        partial(gain, comparison=TE_ADAPTIVE, least_db=5.0),
        SCENES,
        "+7.0 / +9.5 / +6.3 dB",
    ),
    Figure(
        AREA,
        "te-mean",
        "the same, mean over the real static clips",
        "≥ +6 dB",
        partial(mean_gain, comparison=TE_ADAPTIVE, clips=STATIC_CLIPS, least_db=6.0),
    ),
    Figure(
        AREA, "te-gop10", _TE_FIXED, _NOT_BELOW, partial(gain, comparison=TE_FIXED, least_db=0.0), REAL_CLIPS
    ),
    Figure(
        AREA,
        "te-gop10-scenes",
        _TE_FIXED,
        "≥ +5 dB",
        partial(gain, comparison=TE_FIXED, least_db=5.0),
        SCENES,
        "+7.0 / +9.5 / +6.3 dB",
    ),
    Figure(
        AREA,
        "te-gop10-mean",
        "the same, mean over the real static clips",
        "≥ +6 dB",
        partial(mean_gain, comparison=TE_FIXED, clips=STATIC_CLIPS, least_db=6.0),
    ),
    Figure(
        AREA,
        "td",
        _TD,
        "no clip below −0.2 dB",
        partial(gain, comparison=TD_FIXED, least_db=-0.2),
        (*REAL_CLIPS, *SCENES),
        "street, stairway, statue: +6.6 / +6.0 / +4.3 dB",
    ),
    Figure(
        AREA,
        "td-mean",
        "the same, mean over these",
        "≥ +4.5 dB",
        partial(mean_gain, comparison=TD_FIXED, clips=(*REAL_CLIPS, *SCENES), least_db=4.5),
    ),
    Figure(
        AREA,
        "depth-blocks",
        _DEPTH,
        "on the mean",
        partial(gain, comparison=BLOCKS_TO_DEPTH, least_db=None),
        (*REAL_CLIPS, *SCENES),
    ),
    Figure(
        AREA,
        "depth-blocks-mean",
        "the same, mean over these",
        "> 0 dB",
        partial(mean_gain, comparison=BLOCKS_TO_DEPTH, clips=(*REAL_CLIPS, *SCENES), least_db=0.0),
    ),
    Figure(
        AREA,
        "mesh-blocks",
        _MESH,
        "the true figure",
        partial(gain, comparison=BLOCKS_TO_MESH, least_db=None),
        SCENES,
        "+0.7 / +0.5 / +0.2 dB",
    ),
    *(figure for name in _OPTIONS for figure in _option_figures(name)),
)
"""The figures of this module."""
