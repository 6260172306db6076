"""The demonstration: how rates are compared, and what its table says."""

import pytest

from benchmarks.demo import Row, _print_table, _saving


def curve(name: str, rates_kbps: list[float], *, wyner_ziv: bool = True) -> list[Row]:
    """Make up a curve from 30 dB on, in steps of 3 dB."""
    frames = [{"type": "key"}, {"type": "wz" if wyner_ziv else "key"}]
    same = {"per_frame": frames, "decode_s": 1.0}
    same |= dict.fromkeys(("key_psnr_y_db", "wz_psnr_y_db", "si_psnr_y_db"), 30.0)
    return [
        Row(f"{name}, {k}", {"rate_kbps": rate, "psnr_y_db": 30.0 + 3 * k, **same})
        for k, rate in enumerate(rates_kbps)
    ]


def test_rates_are_compared_at_equal_quality() -> None:
    """Rates of a curve are interpolated between its points; beyond them, and with itself, nothing is said."""
    anchor = curve("anchor", [100.0, 400.0])
    between = Row("x", {"rate_kbps": 100.0, "psnr_y_db": 31.5})
    assert _saving(between, anchor) == "-50.0 %"
    assert _saving(Row("x", {"rate_kbps": 100.0, "psnr_y_db": 33.1}), anchor) == ""
    assert _saving(anchor[0], anchor) == ""


def test_table_has_a_line_per_point(capsys: pytest.CaptureFixture[str]) -> None:
    """The savings against 2D and intra stand beside each point of the codec."""
    curves = {
        "3d-te": curve("3d-te", [50.0, 90.0]),
        "2d": curve("2d", [100.0, 180.0]),
        "H.264 intra": curve("H.264 intra", [200.0, 360.0], wyner_ziv=False),
    }
    _print_table(curves)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(",")[0] for line in lines[3:9]] == [name for name in curves for _ in range(2)]
    assert "-50.0 %" in lines[3]
    assert "-75.0 %" in lines[3]
    assert len(lines[8].split()) == 5
