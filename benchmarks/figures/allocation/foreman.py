"""2D coding with one quality for everything, of a scene that moves."""

import json

from benchmarks.figures import rates as rd_figures
from benchmarks.figures.allocation.curves import AREA
from benchmarks.figures.harness import FOREMAN, Figure, Measured, Setting
from dvc.metrics import bd_rate
from dvc.rd.curves import experiments
from dvc.rd.differences import bd_text
from dvc.rd.specification import Sweep, expand

QPS = (24, 28, 32, 36, 40)
MOST_PERCENT = -30.0


def against_opendvc(setting: Setting, clip: str) -> Measured:
    """Compare with the points of openDVC on the same sequence."""
    frames = rd_figures.QUICK_FRAMES if setting.quick else None
    sweep = Sweep((clip,), "2d", gop=2, frames=frames, qp=QPS[:: setting.choose(1, 4)])
    [found] = experiments(rd_figures.measured(setting, clip, expand([sweep])))
    [curve] = found.curves
    other = json.loads(rd_figures.OPENDVC.read_text(encoding="utf-8"))["points"]
    rates_kbps, psnrs_db = ([point[name] for point in other] for name in ("rate_kbps", "psnr_y_db"))
    difference = bd_rate(rates_kbps, psnrs_db, curve.rates_kbps, curve.psnrs_y_db)
    values = {"bd_rate_percent": difference.value, "overlap_db": list(difference.overlap)}
    return Measured(bd_text(difference), difference.value <= MOST_PERCENT, values)


FIGURES = (
    Figure(
        AREA,
        "foreman-2d-qp",
        "2D (--qp) against openDVC, GOP 2: BD-rate",
        "≤ −30 %",
        against_opendvc,
        (FOREMAN,),
    ),
)
"""The figures of this module."""
