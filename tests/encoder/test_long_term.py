"""Long-term references: earlier key frames that are found again."""

import numpy as np
import pytest

from dvc.config import MAX_LONG_TERM_KEY_BYTES, CodecConfig, VideoConfig, codec_config
from dvc.tracks import PointTracks, decode_matches, decode_tracks, encode_tracks
from dvc.video.frames import Plane
from encoder import long_term
from encoder.long_term import LongTermReferences, Thumbnail
from encoder.tracking import PointTracker
from tests.clips import moving_texture

HEIGHT, WIDTH = 96, 128
SEEN = moving_texture(1, HEIGHT, WIDTH, seed=1)[0].luma
OTHER = moving_texture(1, HEIGHT, WIDTH, seed=2)[0].luma


def config_of(groups: int = 8) -> CodecConfig:
    return codec_config(VideoConfig(WIDTH, HEIGHT, 25, 1), gop={"long_term_groups": groups})


def shifted(luma: Plane, dx: int, dy: int) -> Plane:
    """Return a picture whose points are by (dx, dy) away from where they were; the border repeats."""
    rows = np.clip(np.arange(HEIGHT) - dy, 0, HEIGHT - 1)
    return np.ascontiguousarray(luma[rows][:, np.clip(np.arange(WIDTH) - dx, 0, WIDTH - 1)])


def group(luma: Plane, config: CodecConfig, is_new: bool = True) -> tuple[bytes, PointTracks]:
    """Return tracks of a group that ends with a frame, whose points the frame before it has not or has."""
    tracker = PointTracker(config.tracks.num_points, config.tracks.subpixel_bits)
    tracker.start(luma)
    tracker.step(luma)
    positions = tracker.close([luma]).positions.repeat([1, 2], axis=1)
    if is_new:
        positions[:, 0] = np.nan
    payload = encode_tracks(PointTracks(positions, is_new * len(positions)), config)
    return payload, decode_tracks(payload, 3, config)


def references(config: CodecConfig) -> LongTermReferences:
    return LongTermReferences(config, PointTracker(config.tracks.num_points, config.tracks.subpixel_bits))


@pytest.mark.parametrize("shift", [(0, 0), (16, -32), (-32, 16)])
def test_thumbnails_tell_the_shift(shift: tuple[int, int]) -> None:
    """In whole cells, whatever the brightness; the picture that differs is another one."""
    wanted = Thumbnail.of(SEEN)
    moved = Thumbnail.of(np.clip(shifted(SEEN, *shift) + 9.0, 0, 255).astype(np.uint8))
    difference, (dx, dy) = wanted.shift_to(moved)
    assert (16 * dx, 16 * dy) == shift
    assert difference < long_term.MAX_DIFFERENCE * wanted.contrast
    assert wanted.shift_to(Thumbnail.of(OTHER))[0] > difference


def test_a_flat_picture_has_not_moved() -> None:
    """Where all shifts are alike, none is told."""
    flat = Thumbnail.of(np.full((5, 40), 7, np.uint8))
    assert flat.shift_to(flat) == (0.0, (0, 0))


def test_points_are_found_again() -> None:
    """In the key frame that looks most alike, where they are in it; the decoder reads the same places."""
    config = config_of()
    kept = references(config)
    kept.add(0, OTHER, 100)
    kept.add(1, shifted(SEEN, 18, -14), 100)
    payload, tracks = group(SEEN, config)
    found = kept.find(4, SEEN, 3, payload)
    assert found is not None
    assert found.reference.groups_back == 3
    matches = decode_matches(found.reference.matches, tracks, config)
    known = np.isfinite(matches[:, 0])
    assert known.sum() > 20
    assert found.share == pytest.approx(known.mean())
    assert np.abs(matches - tracks.positions[:, -1] - [18, -14])[known].max() <= 0.5


def test_what_is_not_there_is_not_found() -> None:
    """A key frame of something else, one that is too old or too large, and the one right before the group."""
    payload, _ = group(SEEN, config_of())
    for number, luma, num_bytes, groups in (
        (0, OTHER, 100, 8),
        (1, SEEN, 100, 2),
        (1, SEEN, MAX_LONG_TERM_KEY_BYTES + 1, 8),
        (3, SEEN, 100, 8),
        (1, SEEN, 100, 0),
    ):
        kept = references(config_of(groups))
        kept.add(number, luma, num_bytes)
        assert kept.find(4, SEEN, 3, payload) is None
    kept = references(config_of(3))
    kept.add(1, SEEN, MAX_LONG_TERM_KEY_BYTES)
    assert kept.find(4, SEEN, 3, payload) is not None


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """The latest key frames are kept."""
    monkeypatch.setattr(long_term, "MAX_KEPT_PX", 2 * HEIGHT * WIDTH)
    payload, _ = group(SEEN, config_of())
    kept = references(config_of())
    for number, luma in enumerate((SEEN, OTHER, OTHER)):
        kept.add(number, luma, 100)
    assert kept.find(5, SEEN, 3, payload) is None


def test_what_the_frame_before_has_need_not_be_found() -> None:
    """A key frame that shows no more than that spares nothing."""
    config = config_of()
    kept = references(config)
    kept.add(1, SEEN, 100)
    assert kept.find(4, SEEN, 3, group(SEEN, config)[0]) is not None
    assert kept.find(4, SEEN, 3, group(SEEN, config, is_new=False)[0]) is None
