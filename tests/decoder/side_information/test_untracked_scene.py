"""Prediction from a model of the scene without tracks: when it serves, and when it steps back."""

import numpy as np
import pytest

from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.methods import INTERPOLATORS, SceneInterpolation
from decoder.side_information.protocol import ReferenceFrame
from decoder.side_information.scene_interpolators import DepthInterpolator
from dvc.config import GeometryConfig, VideoConfig, codec_config
from dvc.geometry.cameras import PixelFrame
from dvc.metrics import psnr_db
from dvc.video import Frame
from dvc.wynerziv.transform import to_uint8
from tests.scenes_3d import render

FRAME = PixelFrame(176, 144)
CONFIG = codec_config(VideoConfig(176, 144, 25, 1), "3d")
CHROMA = np.full((72, 88), 100, np.uint8), np.full((72, 88), 150, np.uint8)
FRAMES = [Frame(render(position, FRAME)[0], CHROMA) for position in (0.0, 0.25, 0.5, 0.75, 1.0)]
REFERENCES = [ReferenceFrame(8, FRAMES[0]), ReferenceFrame(12, FRAMES[4])]


@pytest.mark.parametrize("name", INTERPOLATORS)
@pytest.mark.parametrize("backend", ["native", "colmap"])
def test_the_scene_serves(name: str, backend: str) -> None:
    config = codec_config(CONFIG.video, "3d", geometry=GeometryConfig(backend))
    predictions = SceneInterpolation(INTERPOLATORS[name], config).predict(REFERENCES, None, [9, 10, 11])
    others = BlockMotionInterpolation().predict(REFERENCES, None, [9, 10, 11])
    for prediction, other, frame in zip(predictions, others, FRAMES[1:4], strict=True):
        assert (prediction.method, prediction.success, prediction.reason) == (name, True, "")
        assert prediction.chroma is not None
        assert abs(int(prediction.chroma[0][36, 44]) - 100) <= 1
        assert psnr_db(to_uint8(prediction.luma), frame.luma) > psnr_db(to_uint8(other.luma), frame.luma)


@pytest.mark.parametrize("name", INTERPOLATORS)
def test_block_motion_serves_where_there_is_no_scene(name: str) -> None:
    cut = [REFERENCES[0], ReferenceFrame(12, Frame(np.zeros((144, 176), np.uint8), CHROMA))]
    [prediction] = SceneInterpolation(INTERPOLATORS[name], CONFIG).predict(cut, None, [10])
    [block_motion] = BlockMotionInterpolation().predict(cut, None, [10])
    assert prediction.method == "mci"
    assert not prediction.success
    assert prediction.reason
    np.testing.assert_array_equal(prediction.luma, block_motion.luma)


def test_order_and_company_do_not_matter() -> None:
    method = SceneInterpolation(DepthInterpolator, CONFIG)
    [alone] = SceneInterpolation(DepthInterpolator, CONFIG).predict(REFERENCES, None, [10])
    method.predict([REFERENCES[0], ReferenceFrame(10, FRAMES[2])], None, [9])
    for _ in range(2):
        [again] = method.predict(REFERENCES, None, [10])
        np.testing.assert_array_equal(again.luma, alone.luma)
        np.testing.assert_array_equal(again.compensated[1], alone.compensated[1])
