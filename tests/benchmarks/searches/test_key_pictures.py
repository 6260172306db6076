"""Settings of libx264 for key pictures: their parameters, and rows of the table."""

from pathlib import Path

import pytest

from benchmarks.searches.key_pictures import REFERENCE, Coded, Tried, coded, front, main, parameters_of, tried
from dvc.contracts.test_side_information import moving_texture
from tests.clips import write_clip

FRAMES = moving_texture(4, 48, 64)


def test_a_setting_replaces_what_is_fixed() -> None:
    usual, own = (parameters_of(text, 30) for text in (REFERENCE, "preset=fast:weightp=1"))
    assert (usual["preset"], usual["weightp"], usual["me"]) == ("medium", "0", "hex")
    assert (own["preset"], own["weightp"]) == ("fast", "1")
    assert (own["crf"], own["zones"]) == ("30", "0,0,q=27")


def test_pictures_are_coded_by_settings() -> None:
    """Coarser ones take fewer bits and look worse; a better search of modes changes the bits."""
    fine, coarse = (coded(FRAMES, parameters_of(REFERENCE, qp)) for qp in (24, 36))
    assert coarse.num_bits < fine.num_bits
    assert coarse.psnr_db < fine.psnr_db - 3.0
    assert fine.cpu_ms > 0.0
    other = coded(FRAMES, parameters_of("subme=1:partitions=none", 24))
    assert other.num_bits != fine.num_bits
    assert coded(FRAMES, parameters_of(REFERENCE, 24), colour=True).num_bits > fine.num_bits


def test_curves_are_compared_by_place() -> None:
    """A tenth more bits at the same PSNR is ten per cent; a place counts like another."""
    usual = [Coded(1000, 34.0, 2.0), Coded(2000, 38.0, 4.0)]
    more = [Coded(1100, 34.0, 1.0), Coded(2200, 38.0, 1.0)]
    found = tried("x", {"a/8": more, "b/8": usual}, {"a/8": usual, "b/8": usual})
    assert found.rates_percent == pytest.approx({"a/8": 10.0, "b/8": 0.0})
    assert (found.rate_percent, found.cpu_ms) == pytest.approx((5.0, 2.0))


def test_what_another_beats_is_left_out() -> None:
    slow, beaten, fast = (
        Tried(name, {"a/8": rate}, cpu_ms)
        for name, rate, cpu_ms in (("slow", -3.0, 5.0), ("beaten", 1.0, 4.0), ("fast", 1.0, 2.0))
    )
    assert front([slow, beaten, fast]) == [fast, slow]


def test_rows_of_a_clip(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One for each combination, that of the reference, and one for all frames at superfast."""
    clip = str(write_clip(tmp_path / "clip.mkv", FRAMES))
    main([clip, "--axes", "subme=1/subme=5", "ref=1", "--every", "1", "--qp", "24", "36", "--all"])
    first, *rows = capsys.readouterr().out.splitlines()
    assert first.startswith("x264 IPPP, superfast, all frames of")
    settings = {row.split("%")[1].split(": ")[0].strip() for row in rows}
    assert settings == {"subme=1:ref=1", "subme=5:ref=1", REFERENCE}
