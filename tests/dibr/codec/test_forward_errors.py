"""Errors of rendered views, and streams of several quality layers."""

import numpy as np
import pytest

from dvc.dibr.codec.decoder import decode
from dvc.dibr.codec.encoder import ViewEncoder
from dvc.dibr.codec.forward_errors import ForwardErrors, parallax_px
from dvc.dibr.codec.views import Views
from dvc.dibr.stream.header import DisparityMethod
from dvc.dibr.stream.layers import decode_stream
from dvc.multiview.camera_array import DisparityLabels, LatticePosition

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
    """With the true disparities, all errors are in the strip that the reference does not see."""
    views = shifted_views()
    errors = ForwardErrors(views.pictures[0], HERE, LABELS, [(views.pictures[1], RIGHT)])
    total, (holes,) = errors.measure(np.full(SHAPE, SHIFT, np.int32))
    assert not holes[:, :-SHIFT].any()
    assert holes[:, -SHIFT:].any()
    assert total == pytest.approx(float(holes.sum()) / 2.0, rel=1e-5)
    assert errors.parallax == pytest.approx(0.5)
    assert errors.measure(np.zeros(SHAPE, np.int32))[0] > 2.0 * total


def test_labels_that_lead_into_holes_are_credited() -> None:
    """The last pixel of a row reaches the hole by labels below the true one."""
    views = shifted_views()
    errors = ForwardErrors(views.pictures[0], HERE, LABELS, [(views.pictures[1], RIGHT)])
    _, holes = errors.measure(np.full(SHAPE, SHIFT, np.int32))
    tensor = np.ones((*SHAPE, LABELS.num_labels), np.float32)
    credited = errors.claimed(tensor, holes, 0.5)
    expected = 1.0 - 0.25 * holes[0][:, ::-1][:, :SHIFT]
    np.testing.assert_allclose(credited[:, -1, :SHIFT], expected, rtol=1e-5)
    np.testing.assert_array_equal(credited[:, -1, SHIFT:], 1.0)


def test_parallax_of_one_label_is_none() -> None:
    """Where nothing can move nothing does."""
    assert parallax_px(np.eye(3, 4), SHAPE, np.array([2.0])) == 0.0


@pytest.mark.parametrize("method", [DisparityMethod.L, DisparityMethod.S], ids=lambda one: one.name)
def test_layers_of_a_cut_stream_are_those_of_the_whole_one(method: DisparityMethod) -> None:
    """The first k layers decode to the same, whether the others follow or have been cut off."""
    views = shifted_views()
    data = ViewEncoder(views, LABELS, method, num_layers=3).encode(1e-4).data
    whole = decode_stream(data)
    assert whole.damage is None
    for count in (1, 2, 3):
        wanted = decode(whole, count)
        cut = decode(whole._replace(layers=whole.layers[:count]))
        assert wanted.num_layers == cut.num_layers == count
        np.testing.assert_array_equal(wanted.pairs[0].picture, cut.pairs[0].picture)
        np.testing.assert_array_equal(wanted.pairs[0].disparity, cut.pairs[0].disparity)
    errors = [
        np.square(decode(whole, k).pairs[0].picture.astype(float) - views.pictures[0]).mean() for k in (1, 3)
    ]
    assert errors[1] < errors[0]
