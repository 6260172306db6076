"""The curves that are compared, on the same 49 frames, and how far two are apart."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.interpolate import PchipInterpolator

from benchmarks.figures import rates as rd_figures
from benchmarks.figures.harness import SCENES, Setting
from benchmarks.figures.tracks.quality import REAL_CLIPS
from dvc.errors import RdCurveError
from dvc.metrics import BdResult, bd_rate, psnr_of_mean_error_db
from dvc.rd.curves import Curve, experiments
from dvc.rd.points import ANCHORS
from dvc.rd.specification import Sweep, expand

AREA = "allocation"
FRAMES = 49
"""One intra frame and 48 others: with fewer, the key frames of a group weigh too much or too little."""
CLIPS = (*REAL_CLIPS, *SCENES)
QPS = (24, 28, 32, 36)
PRESETS = (1, 3, 5, 7)
ANCHOR_QPS = (22, 26, 30, 34, 38)
RANGE_DB = (30.0, 44.0)
"""Qualities that are compared."""
TRACKED = "te-qp"
"""Tracked coding with one quality for everything."""
ONE_WAY = "one-way"
"""The same without a way back from the decoder."""
_CODECS = {
    TRACKED: {"qp": QPS},
    ONE_WAY: {"qp": QPS, "no_feedback": True},
    "presets": {"wz_q": PRESETS},
    "2d": {"codec": "2d", "qp": QPS},
}


@cache
def curve(setting: Setting, clip: str, name: str) -> Curve:
    """Measure a curve; points that are there already are kept."""
    frames = rd_figures.QUICK_FRAMES if setting.quick else FRAMES
    step = setting.choose(1, 3)
    if name in ANCHORS:
        sweep = Sweep((clip,), frames=frames, qp=ANCHOR_QPS, anchors=(name,), anchor_qp=ANCHOR_QPS)
        points = [point for point in expand([sweep]) if point.codec == ANCHORS[name]]
    else:
        points = expand([Sweep((clip,), frames=frames, **_CODECS[name])])[::step]  # type: ignore[arg-type]
    return experiments(rd_figures.measured(setting, clip, points))[0].curves[0]


def by_mean_error(curve: Curve) -> Curve:
    """Return a curve whose quality is the PSNR of the mean squared error of all frames."""
    points = []
    for point in curve.points:
        psnr_db = psnr_of_mean_error_db([float(row["psnr_y_db"]) for row in point.frame_rows])
        totals = point.data["totals"] | {"psnr_y_db": psnr_db}
        points.append(replace(point, data=point.data | {"totals": totals}))
    return replace(curve, points=tuple(points))


def difference(reference: Curve, other: Curve) -> BdResult:
    """Return the mean difference in rate of two curves over the qualities that are compared."""
    return bd_rate(*_within(reference), *_within(other))


def _within(curve: Curve) -> tuple[list[float], list[float]]:
    """Return rates and PSNRs, cut off at both ends of the range, where rates are interpolated."""
    order = np.argsort(curve.psnrs_y_db)
    quality_db, rates = np.asarray(curve.psnrs_y_db)[order], np.asarray(curve.rates_kbps)[order]
    if quality_db[-1] <= RANGE_DB[0] or quality_db[0] >= RANGE_DB[1]:
        raise RdCurveError(f"{curve.label} has no PSNR within {RANGE_DB[0]:g} to {RANGE_DB[1]:g} dB")
    inside = (quality_db >= RANGE_DB[0]) & (quality_db <= RANGE_DB[1])
    found = list(zip(quality_db[inside].tolist(), rates[inside].tolist(), strict=True))
    ends = [end for end in RANGE_DB if quality_db[0] < end < quality_db[-1] and end not in quality_db]
    if ends:
        log_rate = PchipInterpolator(quality_db, np.log(rates))
        found = sorted([*found, *((end, math.exp(float(log_rate(end)))) for end in ends)])
    return [rate for _, rate in found], [psnr for psnr, _ in found]
