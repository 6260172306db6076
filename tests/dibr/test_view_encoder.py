"""The encoder of views: the multiplier of a rate, and errors of rendered views."""

import numpy as np
import pytest

from dvc.dibr.view_encoder import MAX_STEPS, TOLERANCE, Encoded, ForwardErrors, ViewEncoder, parallax_px
from dvc.dibr.view_set import Views
from dvc.dibr.view_stream import decode, decode_stream
from dvc.errors import ConfigError
from dvc.geometry.camera_array import DisparityLabels, LatticePosition


class _Encoder:
    """Pictures whose code is longer at smaller multipliers, in steps; disparities that vary."""

    def __init__(self, grain=1, share=0.15):
        self.count, self.grain, self.share = 0, grain, share

    def _multiplier_of_pictures(self, num_bytes):
        return min((900.0 / max(num_bytes, 1)) ** 2, 10.0)

    def encode(self, multiplier, picture_bytes=None):
        self.count += 1
        if picture_bytes is None:
            picture_bytes = int(900.0 / multiplier**0.5) // self.grain * self.grain
        disparity = int(self.share * 900.0 / multiplier**0.5) + 7 * (self.count % 2)
        return Encoded(bytes(60 + picture_bytes + disparity), multiplier, 60, picture_bytes, disparity)


@pytest.mark.parametrize("max_bytes", [2000, 5000, 30_000, 50_000, 500_000])
@pytest.mark.parametrize(("grain", "share"), [(1, 0.02), (1, 0.15), (1, 0.6), (7000, 0.15)])
def test_streams_are_as_long_as_they_may_be(max_bytes, grain, share):
    encoder = _Encoder(grain, share)
    found = ViewEncoder.encode_to_size(encoder, max_bytes)
    assert (1.0 - 2.0 * TOLERANCE) * max_bytes <= len(found.data) <= max_bytes
    assert encoder.count <= MAX_STEPS


def test_rates_below_the_shortest_stream_are_refused():
    with pytest.raises(ConfigError, match=r"100 bytes are too few: these views need \d+ at least"):
        ViewEncoder.encode_to_size(_Encoder(), 100)


def _views():
    generator = np.random.default_rng(0)
    picture = np.kron(generator.integers(0, 256, (12, 16)), np.ones((4, 4))).astype(np.uint8)
    places = LatticePosition(0, 0), LatticePosition(1, 0), LatticePosition(2, 0)
    return Views(tuple(np.roll(picture, -2 * shift, axis=1) for shift in range(3)), places, (0, 2))


def test_pictures_take_the_bytes_that_they_are_given():
    encoder = ViewEncoder(_views(), DisparityLabels(0.0, 1.0, 4), num_layers=2)
    multiplier = encoder._multiplier_of_pictures(900)
    assert 450 < sum(code.bytes_at_multiplier(multiplier) for code in encoder.codes) < 1400
    headers = 3 * 2 * 2  # of two pictures in two layers
    for given in (multiplier, 9.0 * multiplier):  # the last layer takes what is left
        assert 898 <= encoder.encode(given, 900).picture_bytes - headers <= 900


def test_a_stream_of_a_rate_is_decoded():
    encoder = ViewEncoder(_views(), DisparityLabels(0.0, 1.0, 4), num_layers=3)
    found = ViewEncoder.encode_to_size(encoder, 1500)
    assert 1400 <= len(found.data) <= 1500
    assert decode(decode_stream(found.data)).damage is None
    assert "4 bytes follow" in str(decode(decode_stream(found.data + b"more")).damage)


SHAPE, SHIFT = (24, 32), 3
LABELS = DisparityLabels(0.0, 1.0, 6)
HERE, RIGHT = LatticePosition(0.0, 0.0), LatticePosition(1.0, 0.0)


def shifted_views() -> Views:
    """Return two views of a plane in a texture, at disparity `SHIFT`."""
    rng = np.random.default_rng(0)
    wall = rng.integers(0, 256, (SHAPE[0], SHAPE[1] + SHIFT)).astype(np.uint8)
    left, right = wall[:, : SHAPE[1]].copy(), wall[:, SHIFT:].copy()
    return Views((left, right), (HERE, RIGHT))


def test_errors_are_those_of_holes_where_the_rest_is_right() -> None:
    views = shifted_views()
    errors = ForwardErrors(views.pictures[0], HERE, LABELS, [(views.pictures[1], RIGHT)])
    total, (holes,) = errors.measure(np.full(SHAPE, SHIFT, np.int32))
    assert not holes.errors[:, :-SHIFT].any()
    assert holes.errors[:, -SHIFT:].any()
    assert total == pytest.approx(float(holes.errors.sum()) / 2.0, rel=1e-5)
    np.testing.assert_array_equal(holes.first_label[:, :-SHIFT], SHIFT - 1)  # 1.5 labels behind, rounded up
    np.testing.assert_array_equal(holes.first_label[:, -SHIFT:], 0)
    assert errors.parallax == pytest.approx(0.5)
    assert errors.measure(np.zeros(SHAPE, np.int32))[0] > 2.0 * total


def test_labels_that_lead_into_holes_are_credited() -> None:
    views = shifted_views()
    errors = ForwardErrors(views.pictures[0], HERE, LABELS, [(views.pictures[1], RIGHT)])
    holes = errors.measure(np.full(SHAPE, SHIFT, np.int32))[1]
    tensor = np.ones((*SHAPE, LABELS.num_labels), np.float32)
    credited = errors.claimed(tensor, holes, 0.5)
    expected = 1.0 - 0.25 * holes[0].errors[:, ::-1][:, :SHIFT]
    np.testing.assert_allclose(credited[:, -1, :SHIFT], expected, rtol=1e-5)
    np.testing.assert_array_equal(credited[:, -1, SHIFT:], 1.0)
    covered = [hole._replace(first_label=np.full(SHAPE, 2, np.int32)) for hole in holes]
    hidden = errors.claimed(tensor, covered, 0.5)
    np.testing.assert_array_equal(hidden[..., :2], 1.0)
    np.testing.assert_array_equal(hidden[..., 2:], credited[..., 2:])


def test_parallax_is_that_of_the_middle() -> None:
    warp = np.array([[1.0, 0.0, 0.0, 3.0], [0.0, 1.0, 0.0, 4.0], [0.01, 0.02, 1.0, 0.0]])
    found = parallax_px(warp, (21, 41), np.array([0.0, 1.0, 2.0]))
    assert found == pytest.approx(5.0 / (0.01 * 20.0 + 0.02 * 10.0 + 1.0))
    assert parallax_px(warp, SHAPE, np.array([2.0])) == 0.0
