"""The demonstration: comparison of rates, and its table."""

import pytest

from benchmarks.demo import Row, _print_table, _saving


def curve(name: str, rates_kbps: list[float]) -> list[Row]:
    """Make up a curve from 30 dB on, in steps of 3 dB."""
    frames = [{"type": "key"}, {"type": "wz"}]
    same: dict[str, object] = {"per_frame": frames, "decode_s": 1.0}
    same["si_psnr_y_db"] = 30.0
    return [
        Row(f"{name}, {k}", {"rate_kbps": rate, "psnr_y_db": 30.0 + 3 * k, **same})
        for k, rate in enumerate(rates_kbps)
    ]


def test_rates_are_compared_at_equal_quality() -> None:
    """Rates of a curve are interpolated between its points; beyond them the cell is empty."""
    anchor = curve("anchor", [100.0, 400.0])
    between = Row("x", {"rate_kbps": 100.0, "psnr_y_db": 31.5})
    assert _saving(between, anchor) == "-50.0 %"
    assert _saving(Row("x", {"rate_kbps": 100.0, "psnr_y_db": 33.1}), anchor) == ""


def test_table_has_a_line_per_point(capsys: pytest.CaptureFixture[str]) -> None:
    own = curve("3d-te", [50.0, 90.0])
    anchors = {
        "x264 medium": curve("x264 medium", [100.0, 180.0]),
        "H.264 intra": curve("intra", [200.0, 360.0]),
    }
    _print_table(own, anchors)
    lines = capsys.readouterr().out.splitlines()
    names = [line.split(",")[0] for line in lines[3:9]]
    assert names == ["3d-te", "3d-te", "x264 medium", "x264 medium", "intra", "intra"]
    assert "-50.0 %" in lines[3]
    assert "-75.0 %" in lines[3]
    assert len(lines[8].split()) == 5
