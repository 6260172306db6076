"""Depth, blocks and block motion as one prediction."""

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.methods import METHODS
from decoder.side_information.protocol import Interpolation, ReferenceFrame
from decoder.side_information.scene_interpolators import fuse_scenes
from dvc.config import TracksConfig, VideoConfig, codec_config
from dvc.geometry.cameras import PixelFrame, project
from dvc.tracks import PointTracks
from dvc.video import Frame
from tests.scenes_3d import camera_at, render, two_planes

PIXELS = PixelFrame(176, 144)
KEYS = [ReferenceFrame(4 * k, Frame(render(float(k), PIXELS)[0], None)) for k in (0, 1)]
VIDEO = VideoConfig(176, 144, 25, 1, luma_only=True)


def rendered(level: float, error: float) -> Interpolation:
    """Return an even prediction that expects some error."""
    plane: NDArray[np.float64] = np.full((20, 30), level)
    positions = np.zeros((20, 30, 2))
    return Interpolation(
        plane, (plane, plane), (plane, plane), (positions, positions), np.full_like(plane, error)
    )


def test_the_one_that_expects_less_error_counts_more() -> None:
    for errors, near in (((1.0, 20.0), 100.0), ((20.0, 1.0), 110.0)):
        fused = fuse_scenes(rendered(100.0, errors[0]), rendered(110.0, errors[1]))
        assert (np.abs(fused.luma - near) < 0.5).all()
        np.testing.assert_allclose(fused.compensated[0], fused.luma)
        assert [plane.mean() for plane in fused.hypotheses] == [100.0, 110.0]


def test_shares_are_inverse_squared_errors() -> None:
    """At the same error blocks count half as much as depth, at twice the error an eighth."""
    for errors, share in (((2.0, 2.0), 1 / 3), ((2.0, 4.0), 1 / 9), ((4.0, 2.0), 2 / 3)):
        fused = fuse_scenes(rendered(100.0, errors[0]), rendered(110.0, errors[1]))
        np.testing.assert_allclose(fused.luma, 100.0 + 10.0 * share)


def test_disagreement_is_uncertainty() -> None:
    errors = [fuse_scenes(rendered(100.0, 2.0), rendered(100.0 + d, 2.0)).expected_error for d in (0, 10, 30)]
    np.testing.assert_allclose(errors[0], 2.0)
    assert (errors[0] < errors[1]).all()
    assert (errors[1] < errors[2]).all()


def test_all_hypotheses_are_left_to_the_decoder() -> None:
    """With tracks or without, block motion, depth and blocks are alternatives of what they are fused to."""
    points = two_planes(176, 144).points[:90]
    instants = (0.0, 0.3, 0.5, 0.7, 1.0)
    seen = [PIXELS.to_pixels(project(camera_at(position), points)[0]) for position in instants]
    tracks = PointTracks(np.round(np.stack(seen, axis=1)).astype(np.float64))
    for codec, kind, received in (("3d-te", "encoder", tracks), ("3d", "none", None)):
        config = codec_config(VIDEO, codec, tracks=TracksConfig(kind))
        [found] = METHODS["fused"](config).predict(KEYS, received, [2])
        assert (found.success, found.method) == (True, "fused")
        assert len(found.alternatives) == 3


def test_codecs_without_a_scene_predict_by_block_motion() -> None:
    assert isinstance(METHODS["fused"](codec_config(VIDEO, "2d")), BlockMotionInterpolation)
