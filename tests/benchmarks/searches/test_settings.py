"""Settings that are tried: their syntax, and rows of the table."""

import math
from fractions import Fraction

import pytest

from benchmarks.searches.settings import (
    Coded,
    Trial,
    coded,
    divided,
    encoder_session,
    left_out,
    net_percent,
    row,
)
from dvc.config import NoFeedback, ParityBuffer
from dvc.video import VideoInfo
from sequences.rendered_sequence import RenderedSequence
from tests.clips import write_clip

INFO = VideoInfo(width=64, height=48, frame_rate=Fraction(25))


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Write a few small frames of a rendered clip."""
    views = RenderedSequence("street", 176, 144, num_frames=3).rendered()
    folder = tmp_path_factory.mktemp("clips")
    return str(write_clip(folder / "street.mkv", [view.frame for view in views]))


def test_values_are_read_by_their_types() -> None:
    given, constants = divided("gop.length=8,key.qp=-1,encoder.a.B=2")
    config = encoder_session(INFO, 30, given, ParityBuffer()).config
    assert constants == {"encoder.a.B": "2"}
    assert (config.gop.length, config.key.qp, config.wyner_ziv.qp) == (8, 29, 30)


def test_what_psnr_is_worth_is_taken_off() -> None:
    """A point on the usual curve changes nothing; one that takes a tenth more at the same PSNR does."""
    found = {
        Trial("a", 32, ""): Coded(2000, 38.0),
        Trial("a", 38, ""): Coded(1000, 34.0),
        Trial("a", 32, "x"): Coded(round(2000 * 2**-0.25), 37.0),
        Trial("a", 38, "x"): Coded(1100, 34.0),
    }
    assert net_percent(found, Trial("a", 32, "x")) == pytest.approx(0.0, abs=0.05)
    assert net_percent(found, Trial("a", 38, "x")) == pytest.approx(100 * math.log(1.1))
    assert row(found, "x").startswith("x: +4.77 +- 4.7")
    assert "QP 32 +0.0, 38 +9.5; a +4.8" in row(found, "x")


def test_each_clip_is_left_out_of_the_choice() -> None:
    found = {}
    for clip, bytes_of in {"a": (1000, 900, 1300), "b": (1000, 800, 700), "c": (1000, 990, 700)}.items():
        for settings, num_bytes in zip(("", "x", "y"), bytes_of, strict=True):
            found[Trial(clip, 32, settings)] = Coded(2 * num_bytes, 38.0)
            found[Trial(clip, 38, settings)] = Coded(num_bytes, 34.0)
    text = left_out(found)
    assert "a +26.2 (y), b -22.3 (x), c -1.0 (x)" in text
    assert "+0.97 %" in text


def test_a_clip_is_coded_with_settings(street: str) -> None:
    """Finer key frames take more bytes and look better; constants of the encoder are put back."""
    from dvc import keyframes

    usual, finer = (coded(Trial(street, 40, settings), 2, ParityBuffer()) for settings in ("", "key.qp=-6"))
    assert finer.num_bytes > usual.num_bytes
    assert finer.psnr_db > usual.psnr_db
    before = keyframes.INTRA_QP_OFFSET
    coarser = coded(Trial(street, 40, "dvc.keyframes.INTRA_QP_OFFSET=0"), 2, ParityBuffer())
    assert before == keyframes.INTRA_QP_OFFSET
    assert coarser.num_bytes < usual.num_bytes


def test_there_may_be_no_feedback(street: str) -> None:
    place = Trial(street, 30, "encoder.spacing.ALONE_COST=0.0")
    asked, usual, keys = (
        coded(place._replace(settings=settings), 3, delivery)
        for settings, delivery in (("", ParityBuffer()), ("", NoFeedback()), (place.settings, NoFeedback()))
    )
    assert usual.num_bytes < asked.num_bytes
    assert keys.num_bytes > usual.num_bytes
    assert keys.psnr_db > usual.psnr_db
