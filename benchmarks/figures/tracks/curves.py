"""Rate-distortion curves of tracked coding, and how far two are apart."""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from scipy.interpolate import PchipInterpolator

from benchmarks.figures import rates as rd_figures
from benchmarks.figures.harness import Setting
from dvc.metrics import BdResult, bd_rate
from dvc.rd.curves import Curve, experiments
from dvc.rd.specification import Sweep, expand

HIERARCHICAL = "hierarchical"
FAR_KEYS = "far keys"
"""Predicted from the key frames alone, which are those of hierarchical prediction."""
LONGEST_GOP = {"keys": 8, HIERARCHICAL: 16, FAR_KEYS: 16}
"""The encoder's defaults."""
OPTIONS = {
    "keys": (("references", "keys"),),
    HIERARCHICAL: (("references", HIERARCHICAL),),
    FAR_KEYS: (("longest-track", "64"), ("lost-tracks", "0.6"), ("references", "keys")),
}
"""Options of the encoder by what frames are predicted from."""
FINEST = 8
PRESETS = tuple(range(1, FINEST + 1))


def te_sweep(setting: Setting, clip: str, references: str, wz_q: tuple[int, ...]) -> Sweep:
    """Return the points of a curve of tracked coding."""
    return Sweep(
        (clip,),
        codec="3d-te",
        gop=LONGEST_GOP[references],
        frames=rd_figures.QUICK_FRAMES if setting.quick else setting.frames,
        wz_q=wz_q if not setting.quick else wz_q[::7],
        options=OPTIONS[references],
    )


@cache
def te_curve(setting: Setting, clip: str, references: str, wz_q: tuple[int, ...]) -> Curve:
    """Measure a curve of tracked coding; what is there already is kept."""
    points = expand([te_sweep(setting, clip, references, wz_q)])
    return experiments(rd_figures.measured(setting, clip, points))[0].curves[0]


def up_to(
    rates: Sequence[float], psnrs_db: Sequence[float], highest_db: float
) -> tuple[list[float], list[float]]:
    """Cut a curve off at a quality, where its rate is interpolated."""
    order = np.argsort(psnrs_db)
    quality, rate = np.asarray(psnrs_db)[order], np.asarray(rates)[order]
    if not quality[0] < highest_db < quality[-1] or (np.diff(quality) <= 0).any():
        return list(rates), list(psnrs_db)
    at_end = math.exp(float(PchipInterpolator(quality, np.log(rate))(highest_db)))
    below = quality < highest_db
    return [*rate[below].tolist(), at_end], [*quality[below].tolist(), highest_db]


def difference(reference: Curve, other: Curve, highest_db: float | None = None) -> BdResult:
    """Return the mean difference in rate of two curves."""
    curves = [(curve.rates_kbps, curve.psnrs_y_db) for curve in (reference, other)]
    if highest_db is not None:
        curves = [up_to(*curve, highest_db) for curve in curves]
    return bd_rate(*curves[0], *curves[1])
