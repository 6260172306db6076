"""What no feedback costs: rate over that of streams that a decoder has asked for, and concealed frames."""

import statistics
from functools import cache
from typing import NamedTuple

from benchmarks.figures.allocation.curves import FRAMES, ONE_WAY, TRACKED, by_mean_error, curve, difference
from benchmarks.figures.harness import STATIC_CLIPS, Figure, Measured, Setting, mean_over_clips
from benchmarks.figures.rates import QUICK_FRAMES, measured
from dvc.rd.differences import bd_text
from dvc.rd.point_result import PointResult
from dvc.rd.specification import Sweep, expand

AREA = "cost"
MOST_PERCENT, MOST_ON_A_CLIP_PERCENT = 12.0, 20.0
"""BD-rate over streams with feedback that is asked in the mean, and of every clip."""
MOST_CONCEALED_PERCENT, MOST_LOSS_DB = 2.0, 0.5
"""Frames with a concealed plane, of all Wyner-Ziv frames, and what PSNR they lose, that are asked."""
LOSS_QP = 28
ENOUGH_MARGIN_PERCENT = 1000
"""With so much more, every syndrome is as long as the planes it stands for; these are chosen regardless."""


def over_feedback(setting: Setting, clip: str) -> Measured:
    """Compare streams without feedback with what a decoder asked for."""
    curves = curve(setting, clip, TRACKED), curve(setting, clip, ONE_WAY)
    found, found_mse = difference(*curves), difference(*map(by_mean_error, curves))
    values = {"bd_rate_percent": found.value, "bd_rate_mse_percent": found_mse.value}
    note = f"by mean squared error {found_mse.value:+.1f} %"
    return Measured(bd_text(found), found.value <= MOST_ON_A_CLIP_PERCENT, values, note)


def mean_over_feedback(setting: Setting, clip: str) -> Measured:
    """Average this BD-rate over the real clips of static scenes."""
    del clip

    def _of(one: str) -> float:
        return difference(curve(setting, one, TRACKED), curve(setting, one, ONE_WAY)).value

    return mean_over_clips(setting, STATIC_CLIPS, _of, "{:+.1f} %", lambda mean: mean <= MOST_PERCENT)


class Concealment(NamedTuple):
    """Frames with a concealed plane."""

    num_concealed: int
    num_frames: int  # that are Wyner-Ziv frames
    num_compared: int  # concealed ones at `LOSS_QP`
    loss_db: float  # sum over these

    @property
    def percent(self) -> float:
        """Share of frames."""
        return 100.0 * self.num_concealed / self.num_frames

    @property
    def mean_loss_db(self) -> float:
        """Loss of a frame; 0 if there is none."""
        return self.loss_db / max(self.num_compared, 1)


def concealed_indices(result: PointResult) -> list[int]:
    """List the frames of which a plane is concealed."""
    return [k for k, row in enumerate(result.frame_rows) if row.get("num_failed_planes")]


def psnr_loss_db(result: PointResult, better: PointResult, indices: list[int]) -> float:
    """Add up how much worse frames are than in another result."""
    rows = zip(result.frame_rows, better.frame_rows, strict=True)
    losses = [float(of["psnr_y_db"]) - float(one["psnr_y_db"]) for one, of in rows]
    return sum(losses[index] for index in indices)


@cache
def _concealment(setting: Setting, clip: str) -> Concealment:
    """Count concealed frames at all qualities; at one, compare them with those of an ample stream."""
    points = curve(setting, clip, ONE_WAY).points
    found = [concealed_indices(point) for point in points]
    loss_db, num_compared = 0.0, 0
    for point, indices in zip(points, found, strict=True):
        if point.data["options"].get("qp") == LOSS_QP and indices:
            frames = setting.choose(FRAMES, QUICK_FRAMES)
            sweep = Sweep(
                (clip,), frames=frames, qp=(LOSS_QP,), no_feedback=True, margin=(ENOUGH_MARGIN_PERCENT,)
            )
            (ample,) = measured(setting, clip, expand([sweep]))
            loss_db, num_compared = psnr_loss_db(point, ample, indices), len(indices)
    num_frames = sum(point.num_frames("wz") for point in points)
    return Concealment(sum(map(len, found)), num_frames, num_compared, loss_db)


def _measured(percent: float, loss_db: float, text: str, each: dict[str, list[float]]) -> Measured:
    holds = percent <= MOST_CONCEALED_PERCENT and loss_db <= MOST_LOSS_DB
    return Measured(text, holds, {"concealed_percent": percent, "loss_db": loss_db, "each": each})


def concealed(setting: Setting, clip: str) -> Measured:
    """Count frames whose syndromes were too short, and what that costs them."""
    found = _concealment(setting, clip)
    text = (
        f"{found.num_concealed} of {found.num_frames} frames, {found.percent:.1f} %;"
        f" {found.mean_loss_db:.2f} dB on {found.num_compared}"
    )
    return _measured(found.percent, found.mean_loss_db, text, {clip: list(found)})


def mean_concealed(setting: Setting, clip: str) -> Measured:
    """Average the share of such frames over the real clips of static scenes; and their loss over frames."""
    del clip
    clips = STATIC_CLIPS[: setting.choose(len(STATIC_CLIPS), 1)]
    found = {one: _concealment(setting, one) for one in clips}
    percent = statistics.fmean(one.percent for one in found.values())
    compared = sum(one.num_compared for one in found.values())
    loss_db = sum(one.loss_db for one in found.values()) / max(compared, 1)
    text = f"{percent:.1f} % over {len(clips)} clips; {loss_db:.2f} dB on {compared}"
    return _measured(percent, loss_db, text, {one: list(of) for one, of in found.items()})


_RATE = "--no-feedback against the punctured stream of a run with feedback, 49 frames: BD-rate"
_CONCEALED = "Wyner-Ziv frames with a concealed plane, --no-feedback; their loss of PSNR at QP 28"
_ASKED = f"≤ {MOST_CONCEALED_PERCENT:g} %, ≤ {MOST_LOSS_DB:g} dB"
_MEAN = "the same, mean over these"
FIGURES = (
    Figure(AREA, "over-feedback", _RATE, f"≤ +{MOST_ON_A_CLIP_PERCENT:g} %", over_feedback, STATIC_CLIPS),
    Figure(AREA, "over-feedback-mean", _MEAN, f"≤ +{MOST_PERCENT:g} %", mean_over_feedback),
    Figure(AREA, "concealed", _CONCEALED, _ASKED, concealed, STATIC_CLIPS),
    Figure(AREA, "concealed-mean", _MEAN, _ASKED, mean_concealed),
)
"""The figures of this module."""
