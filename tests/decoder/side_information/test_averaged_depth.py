"""The mean of two predictions by depths that were found in different ways."""

import numpy as np
import pytest

from decoder.side_information import scene_interpolators as averaged_depth
from decoder.side_information.scene_interpolators import (
    AveragedDepthInterpolator,
    DepthInterpolator,
    relative_parallax,
)
from dvc.geometry.cameras import PixelFrame
from dvc.geometry.plane_sweep import CENSUS_SWEEP
from dvc.metrics import psnr_db
from dvc.wynerziv.transform import to_uint8
from tests.scenes_3d import camera_at, render, two_planes

PIXELS = PixelFrame(176, 144)
MODEL = two_planes(176, 144)
FIRST, MIDDLE, SECOND = (render(position, PIXELS)[0] for position in (0.0, 0.5, 1.0))


def test_it_is_not_worse_than_the_mean_of_both(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(averaged_depth, "MIN_PARALLAX", relative_parallax(MODEL))
    luma = AveragedDepthInterpolator(MODEL, FIRST, SECOND).interpolate(camera_at(0.5), 0.5).luma
    single = [
        DepthInterpolator(MODEL, FIRST, SECOND).interpolate(camera_at(0.5), 0.5).luma,
        DepthInterpolator(MODEL, FIRST, SECOND, (None, None), CENSUS_SWEEP)
        .interpolate(camera_at(0.5), 0.5)
        .luma,
    ]
    np.testing.assert_array_equal(luma, 0.5 * (single[0] + single[1]))
    assert min(psnr_db(MIDDLE, to_uint8(one)) for one in single) > 30.0
    errors = [float(np.mean((one - MIDDLE) ** 2)) for one in (luma, *single)]
    assert errors[0] <= 0.5 * (errors[1] + errors[2])


def test_one_depth_is_enough_where_parallax_is_small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(averaged_depth, "MIN_PARALLAX", 1.001 * relative_parallax(MODEL))
    found = AveragedDepthInterpolator(MODEL, FIRST, SECOND).interpolate(camera_at(0.5), 0.5)
    expected = DepthInterpolator(MODEL, FIRST, SECOND).interpolate(camera_at(0.5), 0.5)
    np.testing.assert_array_equal(found.luma, expected.luma)
