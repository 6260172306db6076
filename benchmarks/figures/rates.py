"""Rate and quality: BD-rates, and the balance of key and Wyner-Ziv frames."""

import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from benchmarks.figures.harness import FOREMAN, SCENES, STATIC_CLIPS, Figure, Measured, Setting, clip_source
from dvc.errors import DvcError, RdCurveError
from dvc.metrics import BdResult, bd_rate
from dvc.rd.curves import Curve, Experiment, experiments
from dvc.rd.differences import bd_text, compare_curves
from dvc.rd.point_result import PointResult
from dvc.rd.points import Point, Task
from dvc.rd.provenance import code_version
from dvc.rd.results import POINTS_FOLDER, finished, read_result
from dvc.rd.sources import default_cache
from dvc.rd.specification import Sweep, expand
from dvc.rd.sweep import run_points

OPENDVC = Path(__file__).with_name("opendvc.json")
QUICK_FRAMES = 5
BALANCE_DB = 1.5


def measured(setting: Setting, clip: str, points: Sequence[Point]) -> list[PointResult]:
    """Read the points of one sequence; those that no folder has are measured."""
    source = clip_source(clip)
    own = setting.folder / "rd" / f"{clip}-{points[0].frames or 'all'}"
    tasks = [Task(point, source, code_version()) for point in points]
    places = [_place(setting, task) for task in tasks]
    missing = [task.point for task, place in zip(tasks, places, strict=True) if place is None]
    if missing:
        summary = run_points(
            missing, own, default_cache(), jobs=setting.jobs, any_version=setting.any_version
        )
        if summary.failures:
            raise DvcError("; ".join(f"{name}: {reason}" for name, reason in summary.failures))
    return [
        read_result((place or own) / POINTS_FOLDER / f"{task.name}.json")
        for task, place in zip(tasks, places, strict=True)
    ]


def _place(setting: Setting, task: Task) -> Path | None:
    """Find an experiment of `dvc-rd` that has a point."""
    return next((path for path in setting.points if finished(path, task, setting.any_version)), None)


@cache
def experiment(setting: Setting, clip: str) -> Experiment:
    """Measure the curve of a sequence, and H.264 intra on the same frames; what is there already is kept."""
    frames = QUICK_FRAMES if setting.quick else None if clip == FOREMAN else setting.frames
    sweep = Sweep((clip,), "2d", tuple(range(1, 9)), frames=frames, anchors=("intra",))
    if setting.quick:
        sweep = Sweep((clip,), "2d", frames=frames, anchors=("intra",), wz_q=(1, 3), anchor_qp=(36, 44))
    (found,) = experiments(measured(setting, clip, expand([sweep])))
    return found


def _codec_curve(found: Experiment) -> Curve:
    return next(curve for curve in found.curves if not curve.is_anchor)


def _points(curve: Curve) -> list[dict[str, float | int | None]]:
    names = (
        "rate_kbps",
        "psnr_y_db",
        "key_psnr_y_db",
        "wz_psnr_y_db",
        "si_psnr_y_db",
        "refined_si_psnr_y_db",
    )
    return [
        {"wz_q": point.data["options"]["wz_q"], "key_qp": point.data["key"]["qp"]}
        | {name: point.total(name) for name in names}
        for point in curve.points
    ]


def _measured(difference: BdResult | str, limit: float | None, values: dict[str, object]) -> Measured:
    if isinstance(difference, str):
        raise RdCurveError(difference)
    values |= {"bd_rate_percent": difference.value, "overlap_db": list(difference.overlap)}
    values["num_points"] = list(difference.num_points)
    return Measured(bd_text(difference), None if limit is None else difference.value <= limit, values)


def against_opendvc(setting: Setting, clip: str) -> Measured:
    """Compare with the points of openDVC on the same sequence."""
    curve = _codec_curve(experiment(setting, clip))
    other = json.loads(OPENDVC.read_text(encoding="utf-8"))
    rates_kbps = [point["rate_kbps"] for point in other["points"]]
    psnrs_db = [point["psnr_y_db"] for point in other["points"]]
    difference = bd_rate(rates_kbps, psnrs_db, curve.rates_kbps, curve.psnrs_y_db)
    return _measured(difference, 0.0, {"points": _points(curve), "other": other})


def against_intra(setting: Setting, clip: str) -> Measured:
    """Compare with our own H.264 intra on the same frames."""
    found = experiment(setting, clip)
    anchor = found.anchor()
    assert anchor is not None
    curve = _codec_curve(found)
    intra = [[point.data["key"]["qp"], point.rate_kbps, point.psnr_y_db] for point in anchor.points]
    values: dict[str, object] = {"points": _points(curve), "intra_qp_kbps_db": intra}
    limit = -10.0 if clip == FOREMAN else None
    return _measured(compare_curves(anchor, curve), limit, values)


def balance(setting: Setting, clip: str) -> Measured:
    """Compare the quality of key and Wyner-Ziv frames."""
    gaps_db = {}
    for point in _codec_curve(experiment(setting, clip)).points:
        key_db, wz_db = point.total("key_psnr_y_db"), point.total("wz_psnr_y_db")
        assert key_db is not None
        assert wz_db is not None
        gaps_db[f"Q{point.data['options']['wz_q']}"] = key_db - wz_db
    worst = max(gaps_db, key=lambda name: abs(gaps_db[name]))
    text = f"at most {abs(gaps_db[worst]):.2f} dB, at {worst}"
    return Measured(text, abs(gaps_db[worst]) <= BALANCE_DB, {"key_minus_wz_db": gaps_db})


AREA = "rd"
_CLIPS = (*STATIC_CLIPS, "cube", *SCENES)
_TRUE_FIGURE = "the true figure: what 3D has to beat"
FIGURES = (
    Figure(
        AREA,
        "foreman-opendvc",
        "BD-rate against openDVC, GOP 2, Q1 to Q8",
        "≤ 0 %",
        against_opendvc,
        (FOREMAN,),
    ),
    Figure(
        AREA,
        "foreman-intra",
        "BD-rate against H.264 intra, GOP 2, Q1 to Q8",
        "≤ −10 %",
        against_intra,
        (FOREMAN,),
    ),
    Figure(
        AREA,
        "key-wz-balance",
        "PSNR of key frames minus that of WZ frames",
        "within 1.5 dB",
        balance,
        (FOREMAN,),
    ),
    Figure(
        AREA, "intra", "BD-rate against H.264 intra, GOP 2, Q1 to Q8", _TRUE_FIGURE, against_intra, _CLIPS
    ),
)
"""Figures of this area."""
