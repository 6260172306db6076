"""Which groups no key frame ends."""

import numpy as np
import pytest

from dvc.config import CodecConfig, GopConfig, VideoConfig, allocation
from dvc.errors import ConfigError
from dvc.tracks import PointTracks
from dvc.video import Frame
from dvc.wynerziv.layout import FrameLayout
from encoder import anchors
from encoder.anchors import KeyFrameSpacing, anchor_share
from encoder.groups import Group
from encoder.session import EncodedGroup, EncoderSession
from tests.clips import moving_texture

FRAME = Frame(np.zeros((16, 16), np.uint8), None)
GOP = GopConfig(4, "hierarchical", anchor_distance=2, intra_period=10)


def group_of(length: int, change: float, lost_share: float = 0.0) -> Group:
    """Return a group whose blocks change evenly up to its end."""
    tracks = PointTracks(np.zeros((3, length + 1, 2)))
    changes = tuple(change * (number + 1) / length for number in range(length))
    return Group((FRAME,) * (length - 1), FRAME, tracks, changes=changes, lost_share=lost_share)


def test_shares_grow_with_change_and_loss() -> None:
    """A frame that has not changed costs the least, and not nothing."""
    assert 0 < anchor_share(0.0, 0.0) < anchor_share(2.0, 0.0) < anchor_share(2.0, 0.3)


def test_key_frames_stay_near_enough() -> None:
    """The first group needs one; then those in which nothing changes do without, as long as they may."""
    spacing = KeyFrameSpacing(GOP)
    assert spacing.needs_key(Group((), FRAME))
    needed = [spacing.needs_key(group_of(4, 0.0)) for _ in range(7)]
    assert needed == [False, False, True, False, False, True, False]


@pytest.mark.parametrize("group", [group_of(4, 90.0), group_of(4, 5.0, 1.0), Group((), FRAME)])
def test_what_changes_much_gets_a_key_frame(group: Group) -> None:
    """So does what is not known for want of tracks."""
    spacing = KeyFrameSpacing(GOP)
    spacing.needs_key(Group((), FRAME))
    assert spacing.needs_key(group)
    assert not spacing.needs_key(group_of(4, 0.0))


def test_streams_without_anchors_have_key_frames() -> None:
    """Where the configuration allows no others, all groups end with one."""
    spacing = KeyFrameSpacing(GopConfig(4, "hierarchical"))
    spacing.needs_key(Group((), FRAME))
    assert spacing.needs_key(group_of(4, 0.0))


def test_distance_and_period_come_together() -> None:
    """One without the other means nothing."""
    for given in ({"anchor_distance": 8}, {"intra_period": 96}):
        with pytest.raises(ConfigError, match="together"):
            GopConfig(4, "hierarchical", **given)  # type: ignore[arg-type]


def test_anchors_are_finer_than_what_they_predict(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last frame of a group without key frame has its own, smaller step."""
    monkeypatch.setattr(anchors, "MAX_SHARE", 1e9)
    shared = allocation(30)
    config = CodecConfig.preset(
        "3d-te", VideoConfig(128, 96, 25, 1, luma_only=True), gop=GOP, wyner_ziv=shared.wyner_ziv
    )
    session = EncoderSession(config, allocation=shared)
    groups: list[EncodedGroup] = [
        session.encode(group) for group in session.groups(moving_texture(9, 96, 128, (0.0, 0.25)))
    ]
    assert [bool(group.key) for group in groups] == [True, False, False]
    layout = FrameLayout.of(config)
    steps = [layout.read_header(frame.header).step_indices[0] for frame in groups[1].frames]
    assert len(steps) == 4
    assert steps[1] == steps[3] < steps[0] == steps[2]
    assert session.statistics.num_key_frames == 1
