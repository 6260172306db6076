"""Key frames chosen by tracks, and what the session writes of tracks and points."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from dvc.config import (
    DiscoverMatrix,
    KeyFrameRule,
    NoFeedback,
    ParityBuffer,
    Qp,
    VideoConfig,
    codec_config,
)
from dvc.errors import ConfigError
from dvc.stream import StreamReader
from dvc.tracks import PointTracks, decode_points, decode_tracks
from dvc.video import Frame, open_video
from encoder import spacing
from encoder.__main__ import main
from encoder.encoder_report import TrackingWork
from encoder.encoder_session import EncoderSession
from encoder.groups import CornerGroups, Group, TrackedGroups, thinned, worthwhile
from encoder.point_tracker import PointTracker
from encoder.spacing import Spacing
from tests.clips import moving_texture, write_clip

SLOW = moving_texture(12, 96, 128, (0.0, 1.0))
FREE = KeyFrameRule(longest_track_px=1e6, lost_share=1.0)


def tracked(length: int, rule: KeyFrameRule = FREE, spacing: Spacing | None = None) -> TrackedGroups:
    config = codec_config(VideoConfig(128, 96, 25, 1), gop={"length": length})
    return TrackedGroups(config, rule, 1.0, PointTracker(30), spacing)


def cut(frames: Sequence[Frame], length: int, rule: KeyFrameRule = FREE) -> list[Group]:
    return list(tracked(length, rule).groups(frames))


def sizes_of(groups: Sequence[Group]) -> list[int]:
    return [len(group.wyner_ziv) + 1 for group in groups]


def check_cover(groups: Sequence[Group], frames: Sequence[Frame]) -> None:
    flat = [frame for group in groups for frame in (*group.wyner_ziv, group.key)]
    assert all(a is b for a, b in zip(flat, frames, strict=True))
    for group in groups:
        if group.tracks is not None:
            assert group.tracks.num_instants == len(group.wyner_ziv) + 2
        else:
            assert not group.wyner_ziv


@pytest.mark.parametrize("length", [2, 5, 11, 20])
@pytest.mark.parametrize("num_frames", [0, 1, 2, 3, 12])
def test_groups_have_the_longest_length(num_frames: int, length: int) -> None:
    groups = cut(SLOW[:num_frames], length)
    check_cover(groups, SLOW[:num_frames])
    sizes = sizes_of(groups)
    assert sizes[:1] == [1] * (num_frames > 0)
    assert all(size == length for size in sizes[1:-1])
    assert all(size <= length for size in sizes[1:])


def test_long_tracks_ask_for_a_key_frame() -> None:
    groups = cut(SLOW, 10, KeyFrameRule(longest_track_px=3.0, lost_share=1.0))
    check_cover(groups, SLOW)
    assert sizes_of(groups) == [1, 3, 3, 3, 2]


def test_groups_have_a_least_length() -> None:
    """The least length holds even where tracks are long; it may not exceed the longest."""
    rule = KeyFrameRule(longest_track_px=0.5, lost_share=0.01, min_length=4)
    assert sizes_of(cut(SLOW, 10, rule)) == [1, 4, 4, 3]
    assert sizes_of(cut(SLOW, 2, rule)) == [1, 2, 2, 2, 2, 2, 1]


def test_lost_tracks_ask_for_a_key_frame() -> None:
    fast = moving_texture(8, 64, 96, (0.0, 4.0))
    loose = sizes_of(cut(fast, 8, KeyFrameRule(1e6, 1.0)))
    strict = sizes_of(cut(fast, 8, KeyFrameRule(1e6, 0.1)))
    assert max(strict) < max(loose)


def test_a_cut_stands_between_two_key_frames() -> None:
    """No Wyner-Ziv frame is predicted across a change of scene; the key frame behind it begins a scene."""
    other = moving_texture(5, 96, 128, seed=8)
    for frames, scenes in (([*SLOW[:5], *other], [5]), ([*SLOW[:1], *other], [1]), (SLOW[:5], [])):
        groups = cut(frames, 8)
        check_cover(groups, frames)
        keys = (np.cumsum(sizes_of(groups)) - 1).tolist()
        assert [key for key, group in zip(keys, groups, strict=True) if group.begins_scene] == scenes
        assert {place for scene in scenes for place in (scene - 1, scene)} <= set(keys)


class Deciding(Spacing):
    """Says of groups of some lengths that their ends are too far apart."""

    def __init__(self, *lengths: int) -> None:
        super().__init__(TrackingWork())
        self._lengths = lengths

    def is_too_far(self, frames: Sequence[np.ndarray], tracker: PointTracker) -> bool:
        assert len(tracker.path(len(frames))) > 0
        return len(frames) - 1 in self._lengths


@pytest.mark.parametrize(
    ("lengths", "sizes"),
    [
        ((), [1, 8, 3]),
        ((2,), [1, *[1] * 11]),
        ((4,), [1, 4, 4, 3]),
        ((2, 4), [1, *[1] * 11]),
    ],
)
def test_groups_end_where_prediction_does_not_serve(lengths: Sequence[int], sizes: Sequence[int]) -> None:
    """Two frames become two key frames, and four the end of a group; all frames are there, in order."""
    groups = list(tracked(8, spacing=Deciding(*lengths)).groups(SLOW))
    check_cover(groups, SLOW)
    assert sizes_of(groups) == sizes
    assert not any(group.begins_scene for group in groups)


@pytest.mark.parametrize(
    ("name", "most"), [("ALONE_COST", 1), ("SHORT_COST", 4)], ids=["two singles", "a group of four"]
)
def test_costs_end_groups_without_feedback(name: str, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    for constant in ("ALONE_COST", "SHORT_COST"):
        monkeypatch.setattr(spacing, constant, 0.0 if constant == name else np.inf)
    frames = [Frame(frame.luma ^ (8 * (index % 2))) for index, frame in enumerate(SLOW[:9])]
    config = codec_config(VideoConfig(128, 96, 25, 1), gop={"length": 8})
    found = {}
    for delivery in (NoFeedback(), ParityBuffer()):
        session = EncoderSession(config, delivery, FREE)
        records = [session.encode(group).record for group in session.groups(frames)]
        found[delivery] = [record.num_frames for record in records]
        assert all(bool(record.tracks) == (record.num_frames > 1) for record in records)
    assert found == {NoFeedback(): [1, *[most] * (8 // most)], ParityBuffer(): [1, 8]}


@pytest.mark.parametrize(("num_same", "predicted"), [(6, True), (5, False)], ids=["same", "other scene"])
def test_a_last_frame_alone_is_a_key_frame(num_same: int, predicted: bool) -> None:
    frames = SLOW[:num_same] + moving_texture(6 - num_same, 96, 128, seed=8)
    session = EncoderSession(codec_config(VideoConfig(128, 96, 25, 1), gop={"length": 4}))
    records = [session.encode(group).record for group in session.groups(frames)]
    assert [record.num_frames for record in records] == [1, 4, 1]
    assert [record.predicted for record in records] == [False, True, predicted]
    assert not records[-1].tracks


def test_a_flashed_frame_is_a_key_frame() -> None:
    """A frame that no track reaches is not predicted, and nothing is predicted across it."""
    frames = list(SLOW)
    frames[5] = Frame(255 - frames[5].luma)
    groups = cut(frames, 8)
    check_cover(groups, frames)
    assert {4, 5, 6} <= set((np.cumsum(sizes_of(groups)) - 1).tolist())


def test_hopeless_frames_are_a_matter_of_the_rule() -> None:
    """A scene that changes in part is predicted, unless fewer lost points make a change of scene."""
    other = moving_texture(5, 96, 128, seed=8)
    frames = list(SLOW[:5]) + [
        Frame(np.concatenate([a.luma[:, :40], b.luma[:, 40:]], axis=1))
        for a, b in zip(SLOW[5:10], other, strict=True)
    ]
    kept, split = (cut(frames, 9, KeyFrameRule(1e6, 1.0, cut_share=share)) for share in (1.0, 0.5))
    check_cover(split, frames)
    assert {4, 5} <= set((np.cumsum(sizes_of(split)) - 1).tolist())
    assert len(kept) < len(split)


@pytest.mark.parametrize(
    "luma",
    [np.zeros((48, 64), np.uint8), np.zeros((16, 16), np.uint8), np.full((1, 1), 9, np.uint8)],
    ids=["black", "16x16", "1x1"],
)
def test_frames_without_corners_make_groups(luma: np.ndarray) -> None:
    frames = [Frame(luma) for _ in range(7)]
    groups = cut(frames, 3)
    check_cover(groups, frames)
    assert sizes_of(groups) == [1, 3, 3]
    assert all(not group.tracks for group in groups)


def test_a_still_camera_that_starts_to_move() -> None:
    frames = [SLOW[0]] * 4 + list(SLOW[:4])
    (_, group) = cut(frames, 7)
    assert group.tracks is not None
    moved = group.tracks.positions[:, :, 0] - group.tracks.positions[:, :1, 0]
    assert np.nanmedian(moved, axis=0).tolist() == [0, 0, 0, 0, 0, 1, 2, 3]


def test_corners_of_wyner_ziv_frames() -> None:
    config = codec_config(VideoConfig(128, 96, 25, 1), "3d-td", gop={"length": 4}, tracks={"num_points": 30})
    groups = list(CornerGroups(config, TrackingWork()).groups(SLOW))
    assert sizes_of(groups) == [1, 4, 4, 3]
    for group in groups:
        assert group.points is not None
        assert [len(frame) > 5 for frame in group.points.frames] == [True] * len(group.wyner_ziv)


@pytest.mark.parametrize(
    "rule",
    [
        {"longest_track_px": 0.0},
        {"lost_share": 0.0},
        {"lost_share": 1.5},
        {"min_length": 0},
    ],
)
def test_rules_that_make_no_sense_are_refused(rule: dict[str, float]) -> None:
    with pytest.raises(ConfigError):
        KeyFrameRule(**rule)  # type: ignore[arg-type]


def session_of(codec: str, width: int, height: int, length: int) -> EncoderSession:
    return EncoderSession(
        codec_config(
            VideoConfig(width, height, 25, 1, True), codec, DiscoverMatrix(1), gop={"length": length}
        )
    )


@pytest.mark.parametrize("codec", ["3d-te", "3d-td"])
def test_stream_carries_tracks_or_points(codec: str) -> None:
    session, file = session_of(codec, 128, 96, 4), io.BytesIO()
    session.write(SLOW, file, lambda _: None)
    counted, bits, known = session.statistics, 0, 0
    reader = StreamReader(io.BytesIO(file.getvalue()))
    for record in reader:
        bits += 8 * len(record.tracks)
        if codec == "3d-te":
            known += len(decode_tracks(record.tracks, record.num_frames + 1, reader.config))
        else:
            points = decode_points(record.tracks, record.num_frames - 1, reader.config)
            known += sum(map(len, points.frames))
    assert counted.tracks_bits == bits > 0
    assert 30 < known <= counted.tracking.num_corners
    assert counted.tracking.cpu_s > 0
    assert (counted.tracking.num_blocks > 0) == (codec == "3d-te")
    assert counted.tracking.num_frames == (11 if codec == "3d-te" else 0)


def test_stream_carries_new_tracks(tmp_path: Path) -> None:
    clip = write_clip(tmp_path / "clip.mkv", moving_texture(11, 96, 128, (0.0, 5.0)))
    numbers = []
    for count in ("0", "3", "40"):
        out = tmp_path / f"{count}.dvc"
        arguments = ["--codec", "3d-te", "--gop", "5", "--quiet", "--new-tracks", count]
        arguments += ["--longest-track", "99", "--tracks-bpp", "1"]
        assert main([str(clip), str(out), *arguments]) == 0
        with out.open("rb") as file:
            reader = StreamReader(file)
            groups = [decode_tracks(record.tracks, record.num_frames + 1, reader.config) for record in reader]
            numbers.append([tracks.num_backward for tracks in groups if len(tracks)])
    assert numbers[0] == [0, 0]
    assert max(numbers[1]) <= 3
    assert sum(numbers[0]) < sum(numbers[1]) < sum(numbers[2])


@pytest.mark.parametrize("codec", ["3d-te", "3d-td"])
@pytest.mark.parametrize(
    ("width", "height", "num_frames"), [(16, 16, 3), (33, 27, 2), (33, 27, 1), (8, 8, 5)]
)
def test_small_odd_and_short_videos(codec: str, width: int, height: int, num_frames: int) -> None:
    """Videos of a frame or two and of odd sizes are coded, and decode again to as many frames."""
    session, file = session_of(codec, width, height, 3), io.BytesIO()
    session.write(moving_texture(num_frames, height, width), file, lambda _: None)
    records = list(StreamReader(io.BytesIO(file.getvalue())))
    assert sum(record.num_frames for record in records) == num_frames


def test_tracks_keep_to_their_budget() -> None:
    """Where bits are few a group keeps the tracks that last, and never fewer than cameras need."""
    config = codec_config(VideoConfig(128, 96, 25, 1), gop={"length": 2}, quality=Qp(10))
    kept = []
    for budget in (10.0, 0.035, 0.0001):
        session = EncoderSession(config, None, FREE, budget)
        groups = list(session.groups(SLOW[:5]))
        payloads = [session.encode(group).record.tracks for group in groups[1:]]
        kept.append([len(decode_tracks(payload, 3, session.config)) for payload in payloads])
        if budget == 0.035:
            assert all(8 * len(payload) <= 0.035 * 128 * 96 for payload in payloads)
    assert kept[0] == [len(group.tracks or ()) for group in groups[1:]]
    assert kept[0] > kept[1] > kept[2] == [32, 32]


def test_thinning_keeps_what_lasts() -> None:
    """Of tracks that last as long the first are kept, and as many of each direction as their share is."""
    positions = np.zeros((4, 3, 2))
    positions[:, :, 0] = np.arange(4)[:, None]
    positions[0, 2] = np.nan
    assert thinned(PointTracks(positions), 2).positions[:, 0, 0].tolist() == [1, 2]
    assert thinned(PointTracks(positions), 9).positions[:, 0, 0].tolist() == [0, 1, 2, 3]
    positions[2:, 0] = np.nan
    new_tracks = thinned(PointTracks(positions, 2), 2)
    assert (new_tracks.positions[:, -1, 0].tolist(), new_tracks.num_backward) == ([1, 2], 1)


@pytest.mark.parametrize(("qp", "count"), [(30, 128), (36, 64), (42, 32), (51, 32)])
def test_coarse_qualities_keep_tracks_that_are_far_apart(qp: int, count: int) -> None:
    """The longest go first, each where it starts away from those before; new ones start in the last frame."""
    rng = np.random.default_rng(qp)
    config = codec_config(VideoConfig(352, 288, 25, 1), quality=Qp(qp))
    positions = rng.uniform([0.0, 0.0], [351.0, 287.0], (152, 3, 2))
    positions[:64:2, 2], positions[128::2, 0] = np.nan, np.nan
    tracks = PointTracks(positions, 24)
    kept = worthwhile(tracks, config)
    if count == 128:
        assert kept is tracks
        return
    away = 0.65 * (352 * 288 / count) ** 0.5
    for some, all_of_them, start, most in (
        (kept.forward, tracks.forward, 0, count),
        (kept.backward, tracks.backward, -1, 3 * count // 8),
    ):
        expected: list[np.ndarray] = []
        for track in sorted(all_of_them, key=lambda one: np.isnan(one[:, 0]).any()):
            if all(np.hypot(*(track - other)[start]) >= away for other in expected):
                expected.append(track)
        assert 0 < len(some) <= most
        assert np.array_equal(some, expected[:most], equal_nan=True)


def test_worth_of_tracks_counts_pixels_and_keeps_few() -> None:
    """A frame of four times the pixels has twice as many; no group has too few, or none of no tracks."""
    large = codec_config(VideoConfig(704, 576, 25, 1), quality=Qp(36))
    positions = np.full((150, 2, 2), 7.0)
    positions[:, :, 0] = 4.0 * np.arange(150)[:, None]
    tracks = PointTracks(positions)
    assert worthwhile(tracks, large) is tracks
    none = worthwhile(PointTracks.none(4), codec_config(VideoConfig(16, 16, 25, 1), quality=Qp(51)))
    assert (len(none), none.num_instants) == (0, 4)


def test_command_chooses_key_frames(tmp_path: Path) -> None:
    """Options of the command reach the tracker: a shorter longest track makes more key frames."""
    clip = write_clip(tmp_path / "clip.mkv", SLOW)
    counts = []
    for length_px in ("2", "100"):
        out = tmp_path / f"{length_px}.dvc"
        arguments = ["--codec", "3d-te", "--gop", "6", "--points", "40", "--subpixel", "1", "--quiet"]
        assert (
            main([str(clip), str(out), *arguments, "--longest-track", length_px, "--lost-tracks", "1"]) == 0
        )
        with out.open("rb") as file:
            reader = StreamReader(file)
            counts.append(sum(1 for _ in reader))
            assert (reader.config.tracks.num_points, reader.config.tracks.subpixel_bits) == (40, 1)
    assert counts[0] > counts[1]


@pytest.mark.parametrize(
    "options",
    [
        ["--codec", "2d", "--points", "20"],
        ["--codec", "3d-td", "--min-gop", "2"],
        ["--codec", "3d-te", "--lost-tracks", "2"],
        ["--codec", "3d-te", "--points", "0"],
        ["--codec", "3d-td", "--tracks-bpp", "0.1"],
        ["--codec", "3d-te", "--tracks-bpp", "0"],
        ["--codec", "3d-td", "--new-tracks", "8"],
        ["--codec", "3d-te", "--new-tracks", "-1"],
        ["--codec", "3d-te", "--longest-track", "-1"],
        ["--codec", "3d-te", "--longest-track", "nan"],
        ["--codec", "3d-te", "--scene-change", "0"],
        ["--codec", "3d-te", "--key-frames", "bits"],
        ["--codec", "2d", "--key-frames", "intra", "--intra-period", "9"],
    ],
)
def test_command_refuses_options_that_make_no_sense(
    tmp_path: Path, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    clip = write_clip(tmp_path / "clip.mkv", SLOW[:2])
    try:
        status = main([str(clip), str(tmp_path / "out.dvc"), *options])
    except SystemExit as exit_:
        status = int(exit_.code or 0)
    assert status == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out.dvc").exists()


@pytest.mark.parametrize("clip", ["box", "stone"])
def test_real_clips_stay_within_their_bits(shared_sequences: Path, clip: str) -> None:
    """128 tracks of a CIF clip cost less than 0.01 bits a pixel, even where motion is fast."""
    with open_video(shared_sequences / f"{clip}.mkv", num_frames=17) as reader:
        frames = list(reader)
    session = session_of("3d-te", 352, 288, 8)
    bits = sum(8 * len(session.encode(group).record.tracks) for group in session.groups(frames))
    assert bits < 0.01 * 352 * 288 * len(frames)
    counted = session.statistics.tracking
    assert counted.num_blocks < 0.08 * 1584 * 961 * counted.num_frames
