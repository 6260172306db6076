"""Anchors predicted from earlier frames alone."""

import numpy as np

from decoder.side_information.extrapolation import LongTerm, TrackedExtrapolation
from decoder.side_information.protocol import ReferenceFrame
from dvc.metrics import psnr_db
from dvc.tracks import PointTracks
from tests.clips import moving_texture

MOTION_PX = (1.0, 2.0)


def tracks(num_instants: int) -> PointTracks:
    """Return a grid of points that move with the texture."""
    rows, columns = np.meshgrid(np.arange(8, 56, 8), np.arange(8, 88, 8), indexing="ij")
    start = np.stack([columns.ravel(), rows.ravel()], axis=-1).astype(np.float64)
    steps = np.arange(num_instants)[:, None] * np.array(MOTION_PX[::-1])
    return PointTracks(start[:, None] + steps)


def test_tracks_bring_earlier_frames_into_place() -> None:
    """Inside what one reference or two show, the frame is there; colour comes with it."""
    frames = moving_texture(5, 64, 96, MOTION_PX)
    for indices in ([0], [0, 2]):
        references = [ReferenceFrame(10 + index, frames[index]) for index in indices]
        found = TrackedExtrapolation().predict(references, tracks(5), 10, 14)
        inside = (slice(8, None), slice(12, None))
        assert psnr_db(frames[4].luma[inside], found.luma[inside].round().astype(np.uint8)) > 36
        assert found.chroma is not None
        assert found.chroma[0].shape == (32, 48)
        assert found.expected_error is not None
        assert found.expected_error[:, 0].mean() > found.expected_error[:, 48].mean()
        assert len(found.alternatives) == (0 if len(indices) == 1 else 2)


def test_without_tracks_nothing_has_moved() -> None:
    """A group may come without them."""
    frame = moving_texture(1, 48, 64)[0]
    found = TrackedExtrapolation().predict([ReferenceFrame(3, frame)], None, 3, 4)
    assert np.allclose(found.luma, frame.luma)
    assert found.refiner is not None
    assert np.array_equal(found.refiner.refine(frame.luma).luma, frame.luma)


def test_a_long_term_reference_shows_what_comes_into_view() -> None:
    """What no recent frame has seen is there, and what they show no worse."""
    frames = moving_texture(13, 64, 96, (0.0, 3.0))
    points = np.stack(np.meshgrid(np.arange(4, 96, 8), np.arange(4, 64, 8)), axis=-1).reshape(-1, 2) * 1.0
    before = points - [36.0, 0.0]
    before[before[:, 0] < 0] = np.nan
    tracks = PointTracks(np.stack([before, points], axis=1))
    recent = [ReferenceFrame(4, frames[0])]
    without = TrackedExtrapolation().predict(recent, tracks, 4, 5)
    seen = LongTerm(frames[11], points - [3.0, 0.0])
    found = TrackedExtrapolation().predict(recent, tracks, 4, 5, long_term=seen)
    errors = [(prediction.luma - frames[12].luma) ** 2 for prediction in (without, found)]
    new, old = (slice(None), slice(4, 30)), (slice(None), slice(44, None))
    assert errors[1][new].mean() < 0.1 * errors[0][new].mean()
    assert errors[1][old].mean() < 1.1 * errors[0][old].mean() + 1.0
    assert found.chroma is not None
    assert found.refiner is not None
    assert len(found.refiner.refine(frames[12].luma).compensated) == 2
