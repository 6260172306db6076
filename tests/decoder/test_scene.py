"""Prediction from a model of the scene: when it serves, when it steps back, and how it hedges."""

import numpy as np
import pytest

from decoder.side_information.blending import scene_share
from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.protocol import Prediction, ReferenceFrame
from decoder.side_information.scene import INTERPOLATORS, LARGEST_SHARE, SceneInterpolation, hedged
from decoder.side_information.synthesis import Interpolation
from dvc.config import CodecConfig, GeometryConfig, VideoConfig
from dvc.metrics import psnr_db
from dvc.multiview.cameras import PixelFrame
from dvc.video import Frame
from dvc.wynerziv.transform import to_uint8
from tests.scenes_3d import render

FRAME = PixelFrame(176, 144)
CONFIG = CodecConfig("3d", VideoConfig(176, 144, 25, 1))
CHROMA = np.full((72, 88), 100, np.uint8), np.full((72, 88), 150, np.uint8)
FRAMES = [Frame(render(late, FRAME)[0], CHROMA) for late in (0.0, 0.25, 0.5, 0.75, 1.0)]
REFERENCES = [ReferenceFrame(8, FRAMES[0]), ReferenceFrame(12, FRAMES[4])]


@pytest.mark.parametrize("name", INTERPOLATORS)
@pytest.mark.parametrize("backend", ["native", "colmap"])
def test_the_scene_serves(name: str, backend: str) -> None:
    """A static scene is predicted by the method that was asked for, better than by block motion."""
    config = CodecConfig("3d", CONFIG.video, geometry=GeometryConfig(backend))
    predictions = SceneInterpolation(name, config).predict(REFERENCES, None, [9, 10, 11])
    flat = BlockMotionInterpolation(CONFIG.side_information).predict(REFERENCES, None, [9, 10, 11])
    for prediction, other, frame in zip(predictions, flat, FRAMES[1:4], strict=True):
        assert (prediction.method, prediction.success, prediction.reason) == (name, True, "")
        assert prediction.chroma is not None
        assert abs(int(prediction.chroma[0][36, 44]) - 100) <= 1
        assert psnr_db(to_uint8(prediction.luma), frame.luma) > psnr_db(to_uint8(other.luma), frame.luma)


@pytest.mark.parametrize("name", INTERPOLATORS)
def test_block_motion_serves_where_there_is_no_scene(name: str) -> None:
    """Without a model the prediction is that of block motion, to the bit, and the reason is told."""
    cut = [REFERENCES[0], ReferenceFrame(12, Frame(np.zeros((144, 176), np.uint8), CHROMA))]
    [prediction] = SceneInterpolation(name, CONFIG).predict(cut, None, [10])
    [flat] = BlockMotionInterpolation(CONFIG.side_information).predict(cut, None, [10])
    assert prediction.method == "mci"
    assert not prediction.success
    assert prediction.reason
    np.testing.assert_array_equal(prediction.luma, flat.luma)


def test_order_and_company_do_not_matter() -> None:
    """A frame's prediction is the same whatever was predicted before it, and from which references."""
    method = SceneInterpolation("mesh", CONFIG)
    [alone] = SceneInterpolation("mesh", CONFIG).predict(REFERENCES, None, [10])
    method.predict([REFERENCES[0], ReferenceFrame(10, FRAMES[2])], None, [9])
    for _ in range(2):
        [again] = method.predict(REFERENCES, None, [10])
        np.testing.assert_array_equal(again.luma, alone.luma)
        np.testing.assert_array_equal(again.compensated[1], alone.compensated[1])


def interpolation(motion_px: float) -> Interpolation:
    """Return a prediction of a ramp that moves to the right."""
    rows, columns = np.indices((20, 30)).astype(np.float64)
    early = np.stack([columns, rows], axis=-1)
    late = early + np.array([motion_px, 0.0])
    luma = 4.0 * columns + np.where(rows > 9, 30.0, 0.0)
    half = np.full(luma.shape, 0.5)
    return Interpolation(luma, (luma, luma), (half, half), (early, late), np.ones(luma.shape))


def test_hedging_blurs_along_the_motion_only() -> None:
    """A ramp stays but at its ends, an edge along the motion stays sharp; nothing changes at the keys."""
    rendered = interpolation(20.0)
    mean = hedged(rendered, 0.5)
    np.testing.assert_allclose(mean[:, 6:-6], rendered.luma[:, 6:-6], atol=1e-9)
    assert not np.allclose(mean[:, 0], rendered.luma[:, 0])
    np.testing.assert_allclose(hedged(rendered, 0.0), rendered.luma)
    np.testing.assert_allclose(hedged(interpolation(0.0), 0.5), interpolation(0.0).luma)


def test_the_scene_has_half_a_say_where_it_is_consistent() -> None:
    """The scene's share is one half where it expects little, and falls where it expects much."""
    rendered = interpolation(1.0)
    zeros = np.zeros(rendered.luma.shape)
    flat = Prediction(rendered.luma, None, (zeros, zeros + 3.0), "mci")
    np.testing.assert_allclose(scene_share(flat, rendered, bound=LARGEST_SHARE), 0.5)
    doubtful = rendered._replace(expected_error=np.full(zeros.shape, 40.0))
    assert scene_share(flat, doubtful, bound=LARGEST_SHARE).max() < 0.02


@pytest.mark.parametrize("bound", [0.5, 0.8, 1.0])
def test_the_share_of_the_scene_is_bounded(bound: float) -> None:
    """However little error the scene expects, its share does not exceed the bound, and reaches it."""
    rendered = interpolation(1.0)
    zeros = np.zeros(rendered.luma.shape)
    flat = Prediction(rendered.luma, None, (zeros, zeros + 50.0), "mci")
    sure = rendered._replace(expected_error=zeros)
    np.testing.assert_allclose(scene_share(flat, sure, bound=bound), bound)


def test_block_motion_is_doubted_where_it_is_far_from_the_scene() -> None:
    """References that agree on something else convince less, and what is near the scene is as before."""
    rendered = interpolation(1.0)
    for offset, doubted in ((1.0, False), (60.0, True)):
        luma = rendered.luma + offset
        flat = Prediction(luma, None, (luma, luma), "mci")
        plain, doubting = (scene_share(flat, rendered, doubt=doubt) for doubt in (0.0, 0.25))
        assert (doubting > plain + 0.4).all() if doubted else np.array_equal(doubting, plain)
