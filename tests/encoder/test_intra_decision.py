"""Which groups no key frame ends."""

from dataclasses import replace

import numpy as np
import pytest

from dvc.config import GopConfig, Live, VideoConfig, codec_config
from dvc.errors import ConfigError
from dvc.tracks import PointTracks
from dvc.video import Frame
from dvc.wynerziv.quantizer import FrameLayout
from encoder import intra_decision
from encoder.groups import Group
from encoder.intra_decision import (
    LEAVING_WEIGHT,
    MAX_ESTIMATED_LOST_SHARE,
    MAX_P_TYPE_LOST_SHARE,
    KeyFrameSpacing,
    lost_shares,
)
from encoder.session import EncodedGroup, EncoderSession
from tests.clips import moving_texture

FRAME = Frame(np.zeros((16, 16), np.uint8), None)
SIZE = 16, 16
GOP = GopConfig(4, "hierarchical", p_type_distance=2, intra_period=10)


def group_of(length: int, num_lost: int = 0, num_points: int = 8) -> Group:
    """Return a group some of whose points are lost after its first frame."""
    positions = np.full((num_points, length + 1, 2), 8.0)
    tracks = PointTracks(positions.copy())
    positions[:num_lost, min(2, length) :] = np.nan
    return Group((FRAME,) * (length - 1), FRAME, tracks, path=positions)


def test_shares_are_of_the_points_that_were_there() -> None:
    """Of eight points four reach the first P-type frame, and one of these the second."""
    path = np.full((8, 5, 2), 8.0)
    path[:4, 1:] = np.nan
    path[:7, 3:] = np.nan
    assert lost_shares(path, SIZE, 2, 1.0) == [[0.5, 0.75]]
    assert lost_shares(path, SIZE, 4, 1.0, 0.5) == [[0.875], [0.875]]
    assert lost_shares(path[:0], SIZE, 4, 1.0) == [[1.0]]


def test_points_that_leave_the_picture_count_less() -> None:
    """By their motion, or at its border; those that move as fast along it are lost."""
    path = np.full((4, 4, 2), 8.0)
    path[0, :, 0] = 30.0, 24.0, 18.0, 12.0
    path[1, :, 1] = 30.0, 24.0, 18.0, 12.0
    path[2, :, 0] = 58.0
    path[3, :, 0] = 12.0, 18.0, 24.0, 30.0
    path[:, 3] = np.nan
    path[:, :, 1] += 20.0
    shares = [lost_shares(path[[k]], (64, 64), 4, LEAVING_WEIGHT)[0][0] for k in range(4)]
    assert shares == [1.0, 1.0, LEAVING_WEIGHT, 1.0]
    path[0, 2, 0] = 14.0
    assert lost_shares(path[:1], (64, 64), 4, LEAVING_WEIGHT, 1.0) == [[LEAVING_WEIGHT], [1.0]]


@pytest.mark.parametrize(
    ("max_share", "num_lost"),
    [(MAX_P_TYPE_LOST_SHARE, 53), (MAX_ESTIMATED_LOST_SHARE, 8)],
    ids=["feedback", "estimated"],
)
def test_as_many_points_may_be_lost_as_was_measured(max_share: float, num_lost: int) -> None:
    """Of a hundred points; one more, and there is a key frame."""
    gop = GopConfig(4, "hierarchical", p_type_distance=4, intra_period=99)
    for number, needed in ((num_lost, False), (num_lost + 1, True)):
        spacing = KeyFrameSpacing(gop, max_share)
        spacing.needs_key(Group((), FRAME))
        assert spacing.needs_key(group_of(4, number, 100)) is needed


@pytest.mark.parametrize("num_left", [65, 66])
def test_where_nearly_all_leaves_the_picture_there_is_a_key_frame(num_left: int) -> None:
    """Though points that leave it count little together."""
    spacing = KeyFrameSpacing(GopConfig(4, "hierarchical", p_type_distance=4, intra_period=99))
    spacing.needs_key(Group((), FRAME))
    group = group_of(4, num_left, 100)
    assert group.path is not None
    group.path[:num_left, :2] = 1.0  # at the border
    assert spacing.needs_key(group) is (num_left == 66)


def test_key_frames_stay_near_enough() -> None:
    """The first group needs one; then those in which nothing changes do without, as long as they may."""
    spacing = KeyFrameSpacing(GOP)
    assert spacing.needs_key(Group((), FRAME))
    needed = [spacing.needs_key(group_of(4)) for _ in range(7)]
    assert needed == [False, False, True, False, False, True, False]


@pytest.mark.parametrize("group", [group_of(4, 5), group_of(4, 8), Group((), FRAME)])
def test_what_changes_much_gets_a_key_frame(group: Group) -> None:
    """So does what is not known for want of tracks."""
    spacing = KeyFrameSpacing(GOP)
    spacing.needs_key(Group((), FRAME))
    assert spacing.needs_key(group)
    assert not spacing.needs_key(group_of(4))


@pytest.mark.parametrize("num_lost", [53, 54])
def test_a_frame_alone_needs_a_key_frame_where_it_has_lost_as_much(num_lost: int) -> None:
    """Its tracks are those that it has not lost; without any, nothing is known."""
    spacing = KeyFrameSpacing(GOP)
    spacing.needs_key(Group((), FRAME))
    alone = group_of(1, num_lost, 100)
    assert spacing.needs_key(alone) is (num_lost == 54)
    assert spacing.needs_key(replace(alone, tracks=PointTracks.none(2)))


@pytest.mark.parametrize(
    ("num_lost", "found_share", "needed"), [(5, 0.2, False), (5, 0.1, True), (4, 0.0, False)]
)
def test_what_a_long_term_reference_shows_is_not_lost(
    num_lost: int, found_share: float, needed: bool
) -> None:
    """Five of eight points are too many, but for a fifth of all; where few are lost nothing is looked for."""
    spacing, calls = KeyFrameSpacing(GOP), []
    spacing.needs_key(Group((), FRAME))
    assert spacing.needs_key(group_of(4, num_lost), lambda: calls.append(0) or found_share) is needed
    assert len(calls) == (num_lost == 5)


def test_what_is_lost_adds_up_over_p_type_frames() -> None:
    """A third of the points on the way to each of two is too much, though not to one."""
    path = np.full((9, 5, 2), 8.0)
    path[:3, 2:] = np.nan
    path[:5, 4:] = np.nan
    tracks = PointTracks(path)
    for length, needed in ((4, True), (2, False)):
        spacing = KeyFrameSpacing(replace(GOP, p_type_distance=2))
        spacing.needs_key(Group((), FRAME))
        part = Group((FRAME,) * (length - 1), FRAME, tracks, path=path[:, : length + 1])
        assert spacing.needs_key(part) is needed


def test_streams_without_p_type_frames_have_key_frames() -> None:
    """Where the configuration allows no others, all groups end with one."""
    spacing = KeyFrameSpacing(GopConfig(4, "hierarchical", 0, 0))
    spacing.needs_key(Group((), FRAME))
    assert spacing.needs_key(group_of(4))


def test_distance_and_period_come_together() -> None:
    """One without the other means nothing."""
    for given in ({"p_type_distance": 0}, {"intra_period": 0}):
        with pytest.raises(ConfigError, match="together"):
            GopConfig(4, "hierarchical", **given)  # type: ignore[arg-type]


def test_p_type_frames_are_finer_than_what_they_predict(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last frame of a group without key frame has its own, smaller step."""
    monkeypatch.setattr(intra_decision, "MAX_LOST_SHARE", 1e9)
    config = codec_config(VideoConfig(128, 96, 25, 1, luma_only=True), gop=GOP)
    session = EncoderSession(config, Live())
    groups: list[EncodedGroup] = [
        session.encode(group) for group in session.groups(moving_texture(9, 96, 128, (0.0, 0.25)))
    ]
    assert [bool(group.record.key) for group in groups] == [True, False, False]
    layout = FrameLayout.of(config)
    steps = [layout.read_header(frame.header).step_indices[0] for frame in groups[1].frames]
    assert len(steps) == 4
    assert steps[1] == steps[3] < steps[0] == steps[2]
    assert session.statistics.num_key_frames == 1
