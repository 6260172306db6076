"""A bitrate and a limit of frames, from command to command."""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import decoder.__main__ as decoder
import encoder.__main__ as encoder
from benchmarks.bitrate import deviations, group_rates
from benchmarks.results.live import serving
from dvc.cli import parse_bits
from dvc.geometry.cameras import PixelFrame
from dvc.stream import StreamReader
from dvc.video import Frame
from tests.clips import write_clip
from tests.scenes_3d import render

SIZE, NUM_FRAMES, FRAME_RATE = (104, 88), 240, 25


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write views of a static scene, forth and back."""
    views = [Frame(render(time, PixelFrame(*SIZE))[0]) for time in np.linspace(0.0, 1.0, 21)]
    frames = [*views, *views[-2:0:-1]] * 6
    return write_clip(tmp_path_factory.mktemp("clip") / "clip.y4m", frames[:NUM_FRAMES])


def encoded(clip: Path, folder: Path, *options: str) -> tuple[Path, dict[str, Any]]:
    """Encode the clip without feedback; return the stream and the report."""
    stream, report = folder / "stream.dvc", folder / "encoder.json"
    arguments = [str(clip), str(stream), "--no-feedback", "--luma-only", "--quiet", "--json", str(report)]
    assert encoder.main([*arguments, *options]) == 0
    return stream, json.loads(report.read_text())


def test_a_stream_has_its_bitrate(clip: Path, tmp_path: Path) -> None:
    """In all windows, as far as key frames can be foreseen; its frames are those of any such stream."""
    for bits_per_s, text in ((100_000, "100k"), (150_000, "0.15M")):
        stream, report = encoded(clip, tmp_path, "--bitrate", text)
        off = deviations(group_rates(stream), FRAME_RATE, bits_per_s)
        assert len(off) > 3
        assert max(map(abs, off)) < 0.13
        assert 0 < report["limits"]["peak_buffer_bits"] < 0.6 * bits_per_s
    report = tmp_path / "decoder.json"
    words = [str(stream), str(tmp_path / "decoded.y4m"), "--frames", "0:17", "--json", str(report)]
    assert decoder.main([*words, "--reference", str(clip), "--quiet"]) == 0
    assert json.loads(report.read_text())["psnr_y_db"] > 30.0


def test_frames_that_are_too_large_are_coded_coarser(clip: Path, tmp_path: Path) -> None:
    usual, _ = encoded(clip, tmp_path, "--qp", "20", "--frames", "40")
    assert largest_frame(usual) > 9000
    stream, report = encoded(clip, tmp_path, "--qp", "20", "--frames", "40", "--max-bits-per-frame", "9k")
    assert 4000 < largest_frame(stream) <= 9000
    assert report["limits"] == {"too_large": 0}
    _, report = encoded(clip, tmp_path, "--qp", "20", "--frames", "40", "--max-bits-per-frame", "100")
    assert report["limits"]["too_large"] > 0
    _, tried = encoded(clip, tmp_path, "--bitrate", "90k", "--frames", "40", "--max-bits-per-frame", "100")
    assert tried["limits"]["too_large"] == report["limits"]["too_large"]  # however many qualities are tried


def test_limits_of_segments_are_told(clip: Path, tmp_path: Path) -> None:
    told = {}
    for options in (("--max-bits-per-frame", "100", "--qp", "20"), ("--bitrate", "100k")):
        words = ["--frames", "60", "--segment", "1", "--json", str(tmp_path / "report.json"), *options]
        pattern = tmp_path / f"{options[0][2:]}-%04d.dvc"
        assert encoder.main([str(clip), str(pattern), "--no-feedback", "--luma-only", "--quiet", *words]) == 0
        told |= json.loads((tmp_path / "report.json").read_text())["limits"]
    assert told["too_large"] > 3
    assert 0 < told["peak_buffer_bits"] < 60_000


def test_segments_keep_a_bitrate_together(clip: Path, tmp_path: Path) -> None:
    """Only the first may take more for its first key frame; the others know what was learned before."""
    words = ["--no-feedback", "--luma-only", "--quiet", "--segment", "1", "--bitrate", "60k"]
    assert encoder.main([str(clip), str(tmp_path / "s-%04d.dvc"), *words, "--frames", "200"]) == 0
    sizes = [8 * path.stat().st_size for path in sorted(tmp_path.iterdir())]
    assert len(sizes) == 8
    assert sum(sizes[1:]) / 7 < 66_000


def largest_frame(stream: Path) -> int:
    """Return the most bits that a frame of a stream takes."""
    with StreamReader(stream) as reader:
        return max(8 * len(data) for record in reader for data in (record.key, *record.wyner_ziv))


def test_a_live_decoder_takes_what_it_may(clip: Path, tmp_path: Path) -> None:
    """The bitrate holds for what it took in all; its stream is decoded to the same frames."""
    options = ["--luma-only", "--bitrate", "60k", "--frames", "81"]
    live, stream, again = tmp_path / "live.y4m", tmp_path / "live.dvc", tmp_path / "again.y4m"
    with serving(clip, tmp_path, options) as address:
        words = ["--connect", address, str(live), "--punctured", str(stream), "--quiet"]
        assert decoder.main([*words, "--timeout", "600"]) == 0
    later = group_rates(stream)[1:]
    taken = sum(group.num_bits for group in later) / sum(group.num_frames for group in later)
    assert 0.75 < taken * FRAME_RATE / 60_000 < 1.06
    assert decoder.main([str(stream), str(again), "--frames", "0:17", "--quiet"]) == 0
    assert live.read_bytes().startswith(again.read_bytes())


def test_a_live_decoder_keeps_the_limit_of_frames(clip: Path, tmp_path: Path) -> None:
    """On the mean of a group, but for what runs under way take; it would have asked for more."""
    taken = []
    for limit in ("1M", "600"):
        stream = tmp_path / f"{limit}.dvc"
        options = ["--luma-only", "--qp", "10", "--frames", "17", "--max-bits-per-frame", limit]
        with serving(clip, tmp_path, options) as address:
            words = ["--connect", address, str(tmp_path / "live.y4m"), "--punctured", str(stream), "--quiet"]
            assert decoder.main([*words, "--timeout", "600"]) == 0
        with StreamReader(stream) as reader:
            groups = [[8 * len(data) for data in record.wyner_ziv] for record in reader]
        taken.append(max(np.mean(group) for group in groups if group))
    assert taken[0] > 700
    assert 200 < taken[1] < 1.2 * 600


def test_bits_are_read() -> None:
    """As numbers, thousands or millions; anything else is refused with what is expected."""
    for text, bits in (("300000", 300_000), ("300k", 300_000), ("1.5M", 1_500_000), ("0.1", 1)):
        assert parse_bits(text) == bits
    for text in ("fast", "-1k", "0", "", "k", "1G", "nan", "1e308M"):
        with pytest.raises(argparse.ArgumentTypeError, match=r"such as 300000, 300k or 1\.5M"):
            parse_bits(text)
