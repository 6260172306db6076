"""Which groups no key frame ends."""

import math

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
    MAX_ESTIMATED_SHARE,
    FieldOfMotion,
    KeyFrameSpacing,
    field_of_motion,
    p_type_share,
)
from encoder.session import EncodedGroup, EncoderSession
from tests.clips import moving_texture

FRAME = Frame(np.zeros((16, 16), np.uint8), None)
GOP = GopConfig(4, "hierarchical", p_type_distance=2, intra_period=10)


def group_of(length: int, speed_px: float, num_lost: int = 0) -> Group:
    """Return a group of which eight points move evenly; some are lost after its first frame."""
    positions = np.zeros((8, length + 1, 2))
    positions[:, :, 0] = speed_px * np.arange(length + 1)
    positions[:num_lost, 2:] = np.nan
    return Group((FRAME,) * (length - 1), FRAME, PointTracks(positions))


def test_motion_parallax_and_loss_are_told_apart() -> None:
    """Medians do not mind one point that is wrong."""
    first = np.zeros((8, 2))
    second = np.tile([[3.0, 4.0]], (8, 1))
    second[0] = 90.0
    assert field_of_motion(first, second) == (5.0, 0.0, 0.0)
    second[1:5, 0] += [-2.0, -2.0, 2.0, 2.0]
    second[7] = np.nan
    found = field_of_motion(first, second)
    assert found.motion_px == pytest.approx(5.0)
    assert found.parallax_px == pytest.approx(2.0)
    assert found.lost_share == pytest.approx(1 / 8)
    assert field_of_motion(first, first * np.nan).lost_share == 1.0


def test_shares_grow_with_motion_parallax_and_loss() -> None:
    """A frame that has not moved costs the least, and not nothing."""
    fields = [(0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (5.0, 2.0, 0.0), (5.0, 2.0, 0.3)]
    shares = [p_type_share(FieldOfMotion(*field), 352) for field in fields]
    assert 0 < shares[0] < shares[1] < shares[2] < shares[3]
    assert p_type_share(FieldOfMotion(10.0, 0.0, 0.0), 704) == shares[1]


def moved(speed_px: float, parallax_px: float, num_lost: int) -> Group:
    """Return a group of two frames in a picture of 1000 pixels whose points move, apart, and are lost."""
    positions = np.zeros((16, 3, 2))
    positions[:, :, 0] = speed_px * np.arange(3)
    positions[:, 2, 1] = parallax_px * np.tile([-1.0, 1.0], 8)
    positions[:num_lost, 2] = np.nan
    frame = Frame(np.zeros((16, 1000), np.uint8), None)
    return Group((frame,), frame, PointTracks(positions))


@pytest.mark.parametrize(
    ("max_share", "parallax_px", "num_lost"),
    [(math.inf, 10.3, 6), (MAX_ESTIMATED_SHARE, 4.0, 2)],
    ids=["feedback", "estimated"],
)
def test_as_much_parallax_and_loss_is_spared_as_was_measured(
    max_share: float, parallax_px: float, num_lost: int
) -> None:
    """Up to some pixels of parallax, or of sixteen points lost; more, and there is a key frame."""
    gop = GopConfig(2, "hierarchical", p_type_distance=2, intra_period=99)
    for group, needed in (
        (moved(0.0, parallax_px, 0), False),
        (moved(0.0, parallax_px + 0.4, 0), True),
        (moved(0.0, 0.0, num_lost), False),
        (moved(0.0, 0.0, num_lost + 1), True),
    ):
        spacing = KeyFrameSpacing(gop, max_share)
        spacing.needs_key(Group((), FRAME))
        assert spacing.needs_key(group) is needed


def test_key_frames_stay_near_enough() -> None:
    """The first group needs one; then those in which nothing changes do without, as long as they may."""
    spacing = KeyFrameSpacing(GOP)
    assert spacing.needs_key(Group((), FRAME))
    needed = [spacing.needs_key(group_of(4, 0.0)) for _ in range(7)]
    assert needed == [False, False, True, False, False, True, False]


@pytest.mark.parametrize("group", [group_of(4, 3.0), group_of(4, 0.0, 8), Group((), FRAME)])
def test_what_changes_much_gets_a_key_frame(group: Group) -> None:
    """So does what is not known for want of tracks."""
    spacing = KeyFrameSpacing(GOP)
    spacing.needs_key(Group((), FRAME))
    assert spacing.needs_key(group)
    assert not spacing.needs_key(group_of(4, 0.0))


def test_p_type_frames_that_are_hard_to_predict_need_feedback() -> None:
    """Where rates are estimated, they must be easier; one that is hard gets a key frame in any case."""
    gop = GopConfig(4, "hierarchical", p_type_distance=4, intra_period=99)
    for speed_px, spared in ((0.5, (True, True)), (1.5, (True, False)), (3.0, (False, False))):
        spacings = [KeyFrameSpacing(gop, share) for share in (math.inf, MAX_ESTIMATED_SHARE)]
        for spacing in spacings:
            spacing.needs_key(Group((), FRAME))
        needed = [spacing.needs_key(group_of(4, speed_px)) for spacing in spacings]
        assert tuple(not one for one in needed) == spared


def test_streams_without_p_type_frames_have_key_frames() -> None:
    """Where the configuration allows no others, all groups end with one."""
    spacing = KeyFrameSpacing(GopConfig(4, "hierarchical", 0, 0))
    spacing.needs_key(Group((), FRAME))
    assert spacing.needs_key(group_of(4, 0.0))


def test_distance_and_period_come_together() -> None:
    """One without the other means nothing."""
    for given in ({"p_type_distance": 0}, {"intra_period": 0}):
        with pytest.raises(ConfigError, match="together"):
            GopConfig(4, "hierarchical", **given)  # type: ignore[arg-type]


def test_p_type_frames_are_finer_than_what_they_predict(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last frame of a group without key frame has its own, smaller step."""
    monkeypatch.setattr(intra_decision, "MAX_SHARE", 1e9)
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
