"""Tracked coding with one quality for everything, so that bits pay alike, against H.264."""

from functools import cache, partial

from benchmarks.figures import rates as rd_figures
from benchmarks.figures.harness import SCENES, STATIC_CLIPS, Figure, Measured, Setting, mean_over_clips
from benchmarks.figures.tracks.quality import REAL_CLIPS
from benchmarks.figures.tracks.rates import MEAN
from dvc.errors import DvcError
from dvc.metrics import BdResult
from dvc.rd.curves import Curve, experiments
from dvc.rd.differences import bd_text, compare_curves, crossing_text
from dvc.rd.points import ANCHORS
from dvc.rd.specification import Sweep, expand

AREA = "allocation"
FRAMES = 49
"""One intra frame and 48 others: with fewer, the key frames of a group weigh too much or too little."""
QPS = (24, 28, 32, 36)
ANCHOR_QPS = (22, 26, 30, 34, 38)
ASKED_PERCENT = {"x264-ippp": 10.0, "intra": -70.0}
_TITLES = {
    "x264-ippp": "TE (--qp) against H.264 IPPP with motion search and one intra frame, 49 frames: BD-rate",
    "intra": "TE (--qp) against H.264 intra, 49 frames: BD-rate",
}


@cache
def _curves(setting: Setting, clip: str, anchor: str) -> tuple[Curve, Curve]:
    """Measure the curves of an anchor and of tracked coding; what is there already is kept."""
    frames = rd_figures.QUICK_FRAMES if setting.quick else FRAMES
    qps = QPS[::3] if setting.quick else QPS
    sweep = Sweep((clip,), frames=frames, qp=qps, anchors=(anchor,), anchor_qp=ANCHOR_QPS)
    found = []
    for codec in (ANCHORS[anchor], "3d-te"):
        points = [point for point in expand([sweep]) if point.codec == codec]
        found.append(experiments(rd_figures.measured(setting, clip, points))[0].curves[0])
    return found[0], found[1]


def _difference(setting: Setting, clip: str, anchor: str) -> tuple[BdResult, str]:
    """Return the mean difference in rate of tracked coding, and where it is better."""
    reference, curve = _curves(setting, clip, anchor)
    found = compare_curves(reference, curve)
    if isinstance(found, str):
        raise DvcError(found)
    return found, crossing_text(reference, curve)


def against_anchor(setting: Setting, clip: str, anchor: str) -> Measured:
    """Compare tracked coding with an anchor on one clip.

    Gives BD-rate, where the curves cross, and how far the worst frame of any point is under its mean.

    Parameters
    ----------
    anchor : str
        A key of `ANCHORS`.
    """
    found, crossing = _difference(setting, clip, anchor)
    curve = _curves(setting, clip, anchor)[1]
    worst = max(
        point.psnr_y_db - min(float(row["psnr_y_db"]) for row in point.frame_rows) for point in curve.points
    )
    values = {
        "bd_rate_percent": found.value,
        "overlap_db": list(found.overlap),
        "crossing": crossing,
        "worst_frame_below_mean_db": worst,
    }
    note = f"worst frame {worst:.2f} dB below its mean"
    return Measured(f"{bd_text(found)}; {crossing}", found.value <= ASKED_PERCENT[anchor], values, note)


def mean_against_anchor(setting: Setting, clip: str, anchor: str) -> Measured:
    """Average the BD-rates against an anchor over clips.

    Gives the mean over clips.

    Parameters
    ----------
    anchor : str
        A key of `ANCHORS`.
    """
    del clip

    def difference(name: str) -> float:
        return _difference(setting, name, anchor)[0].value

    limit = ASKED_PERCENT[anchor]
    return mean_over_clips(setting, STATIC_CLIPS, difference, "{:+.1f} %", lambda mean: mean <= limit)


def _figures(anchor: str) -> tuple[Figure, ...]:
    """Return the rows of an anchor: one per clip, and the mean over all static clips."""
    name = f"te-qp-{anchor}"
    asked = f"≤ {ASKED_PERCENT[anchor]:+g} %".replace("-", "−")
    each, mean = partial(against_anchor, anchor=anchor), partial(mean_against_anchor, anchor=anchor)
    return (
        Figure(AREA, name, _TITLES[anchor], asked, each, (*REAL_CLIPS, *SCENES)),
        Figure(AREA, f"{name}-mean", MEAN, asked, mean),
    )


FIGURES = tuple(figure for anchor in _TITLES for figure in _figures(anchor))
"""The figures of this module."""
