"""Figures of one quality for everything, on points that are made up."""

import math

import pytest

from benchmarks.figures.allocation import chroma, curves, frames, planes, rates, times, undetected
from benchmarks.figures.harness import Measured, Setting
from dvc.errors import RdCurveError
from dvc.rd.curves import Curve, Experiment
from dvc.rd.point_result import PointResult


def made_up(psnrs_db: list[float], scale: float = 1.0, spread_db: float = 0.0, seconds: float = 1.0) -> Curve:
    """Make a curve of two frames a point, whose rate doubles every 6 dB."""
    points = []
    for psnr_db in psnrs_db:
        rows = [
            {"type": "wz", "psnr_y_db": psnr_db + sign * spread_db, "bits": {"parity": 1}} for sign in (-1, 1)
        ]
        totals = {
            "rate_kbps": scale * 2 ** (psnr_db / 6),
            "psnr_y_db": psnr_db,
            "decode_s": 2 * seconds,
            "psnr_cb_db": psnr_db + 2 * scale,
            "psnr_cr_db": psnr_db,
            "plane_bits": {"all": {"bits": 11.0, "ideal_bits": 10.0}},
        }
        options = {"qp": round(60 - psnr_db)}
        points.append(
            PointResult(f"at-{psnr_db}", {"totals": totals, "per_frame": rows, "options": options, "key": {}})
        )
    return Curve("made up", False, tuple(points))


def with_curves(monkeypatch: pytest.MonkeyPatch, module: object, **found: Curve) -> None:
    """Let a module find these curves, the first of them where tracked coding is asked for."""
    monkeypatch.setattr(
        module, "curve", lambda _setting, _clip, name: found["tracked" if name == "te-qp" else "other"]
    )


def test_difference_is_within_the_range() -> None:
    """Curves are compared from 30 to 44 dB, interpolated at both ends; beyond it there is nothing."""
    reference, other = made_up([24, 29, 35, 41, 47]), made_up([25, 33, 40, 48], 0.8)
    found = curves.difference(reference, other)
    assert found.overlap == pytest.approx((30, 44))
    assert found.value == pytest.approx(-20, abs=0.1)
    narrow = curves.difference(reference, made_up([33, 36, 39], 0.8))
    assert narrow.overlap == pytest.approx((33, 39))
    with pytest.raises(RdCurveError, match="no PSNR within 30 to 44 dB"):
        curves.difference(reference, made_up([20, 25]))


def test_mean_error_weighs_bad_frames() -> None:
    """The PSNR of the mean squared error is that of the frames' errors; rates stay."""
    curve = made_up([36.0], spread_db=3.0)
    found = curves.by_mean_error(curve)
    expected = -10 * math.log10((10**-3.3 + 10**-3.9) / 2)
    assert found.psnrs_y_db == pytest.approx([expected])
    assert found.rates_kbps == curve.rates_kbps


@pytest.mark.parametrize(("spread_db", "holds"), [(0.0, True), (4.0, False)])
def test_both_errors_are_asked_for(monkeypatch: pytest.MonkeyPatch, spread_db: float, holds: bool) -> None:
    """Against H.264 with one intra frame, what is asked holds by mean squared error, too, or not at all."""
    psnrs_db = [30.0, 35.0, 40.0]
    with_curves(monkeypatch, rates, tracked=made_up(psnrs_db, 1.05, spread_db), other=made_up(psnrs_db))
    found = rates.against(Setting(), "clip", "x264-ippp")
    assert found.values["bd_rate_percent"] == pytest.approx(5, abs=0.1)
    assert (found.values["bd_rate_mse_percent"] > 10) is not holds
    mean = rates.mean_against(Setting(), "", "x264-ippp")
    assert found.holds is mean.holds is holds
    assert mean.values["box_mse"] == pytest.approx(found.values["bd_rate_mse_percent"])
    assert mean.got.startswith("+5.0 % over 5 clips")


def test_presets_ask_more_of_the_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    """No clip above -15 % is not enough for a mean of at most -35 %."""
    psnrs_db = [30.0, 35.0, 40.0]
    with_curves(monkeypatch, rates, tracked=made_up(psnrs_db, 0.8), other=made_up(psnrs_db))
    assert rates.against(Setting(), "clip", "presets").holds is True
    assert rates.mean_against(Setting(), "", "presets").holds is False
    asked = {figure.name: figure.asked for figure in rates.FIGURES}
    assert asked["te-qp-presets"] == "≤ \N{MINUS SIGN}15 %"
    assert asked["te-qp-presets-mean"] == "≤ \N{MINUS SIGN}35 %"


@pytest.mark.parametrize(("spread_db", "holds"), [(3.9, True), (4.1, False)])
def test_worst_frame(monkeypatch: pytest.MonkeyPatch, spread_db: float, holds: bool) -> None:
    """The worst of two frames is below their mean by half of their distance."""
    with_curves(monkeypatch, frames, tracked=made_up([30.0, 40.0], 1, spread_db))
    found = frames.worst_frame(Setting(), "clip")
    assert list(found.values.values()) == pytest.approx([spread_db, spread_db])
    assert found.holds is holds


def test_planes_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ratio is that of the sums over points and clips."""
    with_curves(monkeypatch, planes, tracked=made_up([30.0, 40.0]))
    found = planes.plane_ratio(Setting(), "", "all")
    assert found.values == pytest.approx(dict.fromkeys(found.values, 1.1))
    assert len(found.values) == 6
    assert found.holds is True


def test_times_at_equal_quality(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only qualities that both curves reach count; without any there is nothing to compare."""
    tracked, presets = made_up([30, 36, 42], seconds=3), made_up([33, 39, 45], seconds=2)
    with_curves(monkeypatch, times, tracked=tracked, other=presets)
    found = times.decoding_time(Setting(), "clip")
    assert found.values["ratio"] == pytest.approx(1.5)
    assert found.values["overlap_db"] == [33, 42]
    assert found.holds is False
    with_curves(monkeypatch, times, tracked=tracked, other=made_up([45, 50]))
    with pytest.raises(RdCurveError, match="no PSNR in common"):
        times.decoding_time(Setting(), "clip")


def _chroma(monkeypatch: pytest.MonkeyPatch, own: Curve, intra: Curve) -> Measured:
    found = Experiment("clip", "", "", ("", 0, 0, False), (own, Curve("H.264 intra", True, intra.points)))
    monkeypatch.setattr(chroma.rd_figures, "measured", lambda *_: [])
    monkeypatch.setattr(chroma, "experiments", lambda _: [found])
    return chroma.chroma(Setting(), "clip")


def test_chroma_at_equal_luma(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chroma is compared between two points of H.264 intra; luma out of its range is refused."""
    intra = made_up([28.0, 34.0, 40.0], 3.0)  # chroma 3 dB above luma
    found = _chroma(monkeypatch, made_up([30.0, 36.0], 1.5), intra)
    assert found.values["difference_db"] == pytest.approx([-1.5, -1.5])
    assert found.holds is False
    assert _chroma(monkeypatch, made_up([30.0, 36.0], 2.5), intra).holds is True
    with pytest.raises(RdCurveError, match="luma"):
        _chroma(monkeypatch, made_up([27.0, 36.0]), intra)


def test_wrong_planes_are_found() -> None:
    """Few planes are decoded, all of them are right, and so few prove nothing."""
    found = undetected.undetected_planes(Setting(quick=True), "")
    assert found.values["num_planes"] == 20 * undetected.PLANES_PER_FRAME
    assert found.values["num_undetected"] == found.values["num_failed_frames"] == 0
    assert found.values["upper_95"] == pytest.approx(1 - 0.05 ** (1 / found.values["num_planes"]))
    assert found.holds is False
