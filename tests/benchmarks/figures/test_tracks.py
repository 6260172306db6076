"""Figures of tracked coding: the predictions behind them, and their curves."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.figures import definitions, rates
from benchmarks.figures.harness import Setting
from benchmarks.figures.tracks import costs, curves, limits, points, prediction, quality, runs
from benchmarks.figures.tracks.runs import BLOCK_MOTION, TD_DEPTH, TE_DEPTH, Run, Way
from dvc.multiview.cameras import PixelFrame
from dvc.rd.processes import ProcessGroup
from dvc.rd.sources import Source, find_source
from dvc.tracks import FeaturePoints, PointTracks
from dvc.video import Frame, open_video
from encoder.options import parser, session
from tests.clips import write_clip
from tests.scenes_3d import render

FRAMES = 5


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a few small views of a static scene."""
    views = [render(time, PixelFrame(96, 80))[0] for time in np.linspace(0.0, 1.0, FRAMES)]
    path = tmp_path_factory.mktemp("clip") / "clip.mkv"
    return write_clip(path, [Frame(view).with_chroma() for view in views])


@pytest.mark.parametrize(
    ("options", "length"),
    [
        (["3d-te", "--references", "keys"], runs.GOP["3d-te"]),
        (["3d-td", "--references", "keys"], runs.GOP["3d-td"]),
        (["3d-te"], runs.HIERARCHICAL_GOP),
    ],
)
def test_distances_are_those_of_the_encoder(clip: Path, options: list[str], length: int) -> None:
    """Key frames are as far apart as the encoder puts them by itself."""
    arguments = parser().parse_args([str(clip), "s.dvc", "--codec", *options])
    with open_video(clip) as reader:
        assert session(arguments, reader.info).config.gop.length == length


@pytest.mark.parametrize(("way", "kind"), [(TE_DEPTH, PointTracks), (TD_DEPTH, FeaturePoints)])
def test_groups_have_what_was_sent(clip: Path, way: runs.Way, kind: type) -> None:
    """A group holds decoded key frames, the originals between them, and points out of their payload."""
    [group] = prediction.received_groups(Run(str(clip), way, FRAMES, FRAMES - 1))
    assert [key.index for key in group.keys] == [0, FRAMES - 1]
    assert len(group.originals) == FRAMES - 2
    assert isinstance(group.points, kind)
    assert group.tracks_bits > 0
    assert len(group.num_points) == FRAMES - 2
    assert min(group.num_points) > 0


def test_results_are_kept(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames are predicted once; a second process reads what the first has found."""
    run = Run(clip.name, BLOCK_MOTION, FRAMES, FRAMES - 1, every=2)
    monkeypatch.setattr(prediction, "clip_source", lambda _: _source(clip))
    found = prediction.frame_results(run, tmp_path)
    assert [frame.index for frame in found] == [1, 3]
    assert all(15 < frame.psnr_db < 60 for frame in found)
    prediction._frame_results.cache_clear()
    monkeypatch.setattr(prediction, "predictions", None)
    assert prediction.frame_results(run, tmp_path) == found
    assert prediction.mean_db(run, tmp_path) == np.mean([frame.psnr_db for frame in found])


def test_points_have_what_is_predicted(clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Side information is the same in the file of a point, as decoded, as it is without coding."""
    monkeypatch.chdir(clip.parent)
    run = Run(clip.name, TE_DEPTH, FRAMES, FRAMES - 1)
    setting = Setting(folder=tmp_path)
    found = points.quality(setting, run)
    assert found.key_db == 100
    assert found.num_frames == FRAMES - 2
    predicted = prediction.frame_results(run, tmp_path)
    assert found.mean_db == pytest.approx(np.mean([frame.psnr_db for frame in predicted]), abs=0.01)
    own = tmp_path / "rd" / f"{clip.name}-{FRAMES}"
    elsewhere = replace(setting, folder=tmp_path / "empty", points=(own,))
    monkeypatch.setattr(rates, "run_points", None)
    assert points.quality(elsewhere, run) == found


def test_points_are_told_what_a_way_is() -> None:
    """Options that only a decoder knows are those of the point's decoder."""
    way = Way("3d-te", "fused", track_corrections=True, path_regularity=0.03, subpixel_bits=0)
    point = points.point_of(Run("box", way, 31, 10))
    assert point.decoder_options() == [
        *("--side-information", "fused", "--path-regularity", "0.03", "--track-corrections")
    ]
    assert point.encoder_options()[-12:-2] == [
        *("--longest-track", "10000", "--lost-tracks", "1", "--min-gop", "10", "--references", "keys"),
        *("--scene-change", "1"),
    ]
    assert point.to_dict()["decoder"] == {"path-regularity": "0.03", "track-corrections": "true"}
    assert "decoder" not in replace(point, decoder=()).to_dict()
    adaptive = points.point_of(Run("box", TE_DEPTH, 31))
    assert (adaptive.gop, adaptive.options) == (runs.GOP["3d-te"], (("references", "keys"),))


def _source(clip: Path) -> Source:
    return find_source(str(clip), clip.parent, ProcessGroup())


def test_ceiling_undoes_motion() -> None:
    """Key frames that are shifted copies of a frame are shifted back on to it."""
    rng = np.random.default_rng(0)
    scene = np.kron(rng.integers(40, 200, (16, 18)), np.ones((6, 6))).astype(np.uint8)
    frame, before, after = (np.ascontiguousarray(scene[4:84, k : k + 96]) for k in (4, 2, 7))
    predicted = limits.motion_ceiling(frame, (before, after), 0.4)
    assert np.abs(predicted - frame)[8:-8, 8:-8].mean() < 4.0
    still = limits.motion_ceiling(frame, (frame, frame), 0.5)
    assert np.abs(still - frame).mean() < 0.5


def test_fixed_groups_ignore_tracks() -> None:
    """The rule for a fixed distance asks for no key frame before it, however long tracks are."""
    rule = prediction.key_frame_rule(10)
    assert rule.longest_track_px == np.inf
    assert (rule.min_length, rule.lost_share) == (10, 1.0)
    assert prediction.key_frame_rule(None).min_length < 10


def test_curves_are_cut_off() -> None:
    """A curve that is cut off has its interpolated rate there; one that ends below stays as it is."""
    quality_db = [30.0, 33.0, 36.0, 39.0]
    rates_kbps = [100.0 * 2 ** ((value - 30.0) / 3.0) for value in quality_db]
    rate, quality = curves.up_to(rates_kbps, quality_db, 34.5)
    assert quality == [30.0, 33.0, 34.5]
    assert rate[-1] == pytest.approx(100.0 * 2**1.5, rel=1e-6)
    assert curves.up_to(rates_kbps, quality_db, 40.0) == (rates_kbps, quality_db)


def test_sweeps_are_tracked_coding() -> None:
    """A curve is made with the codec's own distance of key frames and the references asked for."""
    sweep = curves.te_sweep(Setting(frames=13), "box", curves.HIERARCHICAL, (8,))
    [point] = sweep.points()
    options = point.encoder_options()
    assert options[:4] == ["--codec", "3d-te", "--gop", str(runs.HIERARCHICAL_GOP)]
    assert options[-2:] == ["--references", "hierarchical"]
    assert "--frames" in options


def test_commands_say_how_many_frames() -> None:
    """The command of a row names the number of frames where it is not the default."""
    [figure] = [figure for figure in quality.FIGURES if figure.name == "te-mean"]
    row = definitions.with_frames(figure.row(None, None), 31)
    assert row["command"].endswith("--area tracks --name te-mean --frames 31")


def test_operations_of_the_tracker_are_few(clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The share of a full search is counted, and small."""
    monkeypatch.setattr(costs, "clip_source", lambda _: _source(clip))
    measured = costs.operations(Setting(quick=True), "clip")
    shares = dict(measured.values["share_by_reach_px"])
    assert 0 < shares[16] < shares[7] < 0.5


def test_points_of_corners_are_predicted_from_key_frames() -> None:
    """Points of 3d-td have their key frames at a fixed distance, and no other references."""
    point = points.point_of(Run("box", TD_DEPTH, 31, 10))
    assert (point.codec, point.gop, point.options) == ("3d-td", 10, (("references", "keys"),))
    assert parser().parse_args(["in", "out", *point.encoder_options()]).references == "keys"
