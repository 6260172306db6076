"""Tracked coding against H.264 with prediction between frames, without motion and with motion search."""

from functools import cache, partial

from benchmarks.figures import rates as rd_figures
from benchmarks.figures.harness import SCENES, STATIC_CLIPS, Figure, Measured, Setting, mean_over_clips
from benchmarks.figures.tracks.curves import HIERARCHICAL, PRESETS, te_curve
from benchmarks.figures.tracks.quality import REAL_CLIPS
from benchmarks.figures.tracks.rates import MEAN
from dvc.errors import DvcError
from dvc.metrics import BdResult
from dvc.rd.curves import Curve, experiments
from dvc.rd.differences import bd_text, compare_curves, crossing_text
from dvc.rd.points import ANCHORS
from dvc.rd.specification import Sweep, expand

AREA = "anchors"
_TITLES = {
    "x264-ippp-zero": "TE (hierarchical) against H.264 IPPP without motion, Q1 to Q8: BD-rate",
    "x264-ippp": "TE (hierarchical) against H.264 IPPP with motion search, Q1 to Q8: BD-rate",
}
_THESIS = {"x264-ippp-zero": "better up to 0.9 to 1.4 Mbit/s", "x264-ippp": "worse"}


@cache
def anchor_curve(setting: Setting, clip: str, anchor: str) -> Curve:
    """Measure the curve of an anchor on the frames that the codecs are measured on; what is there is kept."""
    frames = rd_figures.QUICK_FRAMES if setting.quick else setting.frames
    sweep = Sweep((clip,), wz_q=tuple(range(1, 9)), frames=frames, anchors=(anchor,))
    points = [point for point in expand([sweep]) if point.codec == ANCHORS[anchor]]
    return experiments(rd_figures.measured(setting, clip, points))[0].curves[0]


def _difference(setting: Setting, clip: str, anchor: str) -> tuple[BdResult, str]:
    """Return the mean difference in rate of tracked coding, and where it is better."""
    reference = anchor_curve(setting, clip, anchor)
    curve = te_curve(setting, clip, HIERARCHICAL, PRESETS)
    found = compare_curves(reference, curve)
    if isinstance(found, str):
        raise DvcError(found)
    return found, crossing_text(reference, curve)


def against_anchor(setting: Setting, clip: str, anchor: str) -> Measured:
    """Compare tracked coding with an anchor on one clip."""
    found, crossing = _difference(setting, clip, anchor)
    values = {"bd_rate_percent": found.value, "overlap_db": list(found.overlap), "crossing": crossing}
    return Measured(f"{bd_text(found)}; {crossing}", found.value < 0.0, values)


def mean_against_anchor(setting: Setting, clip: str, anchor: str, clips: tuple[str, ...]) -> Measured:
    """Average the BD-rates against an anchor over clips."""
    del clip

    def difference(name: str) -> float:
        return _difference(setting, name, anchor)[0].value

    return mean_over_clips(setting, clips, difference, "{:+.1f} %", lambda mean: mean < 0.0)


def _figures(anchor: str) -> tuple[Figure, ...]:
    """Return the rows of an anchor: one per clip, and the mean over all static clips."""
    name, asked, thesis = f"te-{anchor}", "negative", _THESIS[anchor]
    each = partial(against_anchor, anchor=anchor)
    mean = partial(mean_against_anchor, anchor=anchor, clips=STATIC_CLIPS)
    return (
        Figure(AREA, name, _TITLES[anchor], asked, each, (*REAL_CLIPS, *SCENES), thesis),
        Figure(AREA, f"{name}-mean", MEAN, asked, mean),
    )


FIGURES = tuple(figure for anchor in _TITLES for figure in _figures(anchor))
"""The figures of this module."""
