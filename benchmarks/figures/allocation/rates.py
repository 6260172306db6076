"""Tracked coding with one quality for everything against other codecs and against presets: BD-rates."""

from dataclasses import dataclass
from functools import partial

from benchmarks.figures.allocation.curves import AREA, CLIPS, TRACKED, by_mean_error, curve, difference
from benchmarks.figures.harness import STATIC_CLIPS, Figure, Measured, Setting, mean_over_clips
from benchmarks.figures.tracks.rates import MEAN
from dvc.rd.differences import bd_text, crossing_text


@dataclass(frozen=True)
class Comparison:
    """What tracked coding is compared with."""

    reference: str  # name of the curve
    title: str  # what it is
    most_percent: float  # BD-rate that is asked on the mean over clips
    most_on_a_clip_percent: float  # BD-rate that is asked on each clip
    by_both: bool = False  # whether what is asked holds for the PSNR of the mean squared error, too


COMPARISONS = {
    "x264-ippp": Comparison(
        "x264-ippp", "H.264 IPPP with motion search and one intra frame", 10.0, 10.0, by_both=True
    ),
    "x264-ippp-16": Comparison(
        "x264-ippp-16", "H.264 IPPP with motion search and an intra frame every 16", -15.0, -15.0
    ),
    "intra": Comparison("intra", "H.264 intra", -70.0, -70.0),
    "presets": Comparison("presets", "TE with presets (--wz-q)", -35.0, -15.0),
    "2d": Comparison("2d", "2D-DVC with the same allocation (--codec 2d --qp)", -45.0, -45.0),
    "zero-motion": Comparison("x264-ippp-zero", "H.264 IPPP without motion", -65.0, -65.0),
}
"""By the ends of the rows' names."""


def _bd_rates(setting: Setting, clip: str, reference: str) -> tuple[float, float]:
    """Return BD-rates by the mean of PSNRs, and by the PSNR of the mean squared error."""
    curves = curve(setting, clip, reference), curve(setting, clip, TRACKED)
    return difference(*curves).value, difference(*map(by_mean_error, curves)).value


def against(setting: Setting, clip: str, name: str) -> Measured:
    """Compare tracked coding with something else on one clip."""
    comparison = COMPARISONS[name]
    curves = curve(setting, clip, comparison.reference), curve(setting, clip, TRACKED)
    found, crossing = difference(*curves), crossing_text(*curves)
    of_errors = [by_mean_error(one) for one in curves]
    found_mse, crossing_mse = difference(*of_errors), crossing_text(*of_errors)
    values = {
        "bd_rate_percent": found.value,
        "bd_rate_mse_percent": found_mse.value,
        "overlap_db": list(found.overlap),
        "crossing": crossing,
        "crossing_mse": crossing_mse,
    }
    note = f"by mean squared error {found_mse.value:+.1f} %, {crossing_mse}"
    most = max(found.value, found_mse.value) if comparison.by_both else found.value
    holds = most <= comparison.most_on_a_clip_percent
    return Measured(f"{bd_text(found)}; {crossing}", holds, values, note)


def mean_against(setting: Setting, clip: str, name: str) -> Measured:
    """Average these BD-rates over clips."""
    del clip
    comparison = COMPARISONS[name]
    rates = partial(_bd_rates, setting, reference=comparison.reference)
    by_psnr, by_mse = (
        mean_over_clips(
            setting,
            STATIC_CLIPS,
            lambda one, which=which: rates(one)[which],  # type: ignore[misc]
            "{:+.1f} %",
            lambda mean: mean <= comparison.most_percent,
        )
        for which in (0, 1)
    )
    holds = bool(by_psnr.holds and (by_mse.holds or not comparison.by_both))
    values = by_psnr.values | {f"{one}_mse": value for one, value in by_mse.values.items()}
    return Measured(by_psnr.got, holds, values, f"by mean squared error {by_mse.got}")


def _figures(name: str, comparison: Comparison) -> tuple[Figure, ...]:
    """Return the rows of a comparison: one per clip, and the mean over all static clips."""
    each, mean = (
        f"≤ {limit:+g} %".replace("-", "−") + (", by mean squared error, too" if comparison.by_both else "")
        for limit in (comparison.most_on_a_clip_percent, comparison.most_percent)
    )
    title = f"TE (--qp) against {comparison.title}, 49 frames: BD-rate"
    return (
        Figure(AREA, f"te-qp-{name}", title, each, partial(against, name=name), CLIPS),
        Figure(AREA, f"te-qp-{name}-mean", MEAN, mean, partial(mean_against, name=name)),
    )


FIGURES = tuple(figure for name, comparison in COMPARISONS.items() for figure in _figures(name, comparison))
"""The figures of this module."""
