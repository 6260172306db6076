"""Comparison of two experiments: for instance the same sweep before and after a change."""

from collections.abc import Sequence

from dvc.errors import DvcError, RdCurveError
from dvc.rd.curves import Curve, bd_text, compare_curves, experiments
from dvc.rd.report import table
from dvc.rd.results import PointResult


def compare_results(before: Sequence[PointResult], after: Sequence[PointResult]) -> str:
    """Compare the curves that two experiments have in common.

    Parameters
    ----------
    before, after : sequence of PointResult
        Results of each.

    Returns
    -------
    str
        Markdown table: BD-rate and BD-PSNR of `after` against `before` per sequence and codec.

    Raises
    ------
    DvcError
        If they have no curve in common.
    """
    known = {(one.key, curve.label): curve for one in experiments(before) for curve in one.curves}
    rows = [
        [
            one.name,
            curve.label,
            bd_text(compare_curves(known[one.key, curve.label], curve)),
            _psnr_text(known[one.key, curve.label], curve),
        ]
        for one in experiments(after)
        for curve in one.curves
        if (one.key, curve.label) in known
    ]
    if not rows:
        raise DvcError("the two experiments have no codec and sequence in common")
    return table(["sequence", "codec", "BD-rate (overlap, points)", "BD-PSNR"], rows)


def _psnr_text(before: Curve, after: Curve) -> str:
    from dvc.metrics import bd_psnr

    try:
        difference = bd_psnr(before.rates_kbps, before.psnrs_y_db, after.rates_kbps, after.psnrs_y_db)
    except RdCurveError as err:
        return f"not comparable: {err}"
    return f"{difference.value:+.2f} dB"
