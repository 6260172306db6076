"""Baselines of two views: sizes are met, frames decode, and right disparities are better."""

import math
from functools import cache

import numpy as np
import pytest

from benchmarks.baselines.picture_coders import AVIF, JPEG2000, quality_of
from benchmarks.baselines.two_views import (
    X264,
    X265,
    PictureAndDepth,
    VideoCoder,
    baselines_of,
    decode_frames,
    encode_frames,
)
from dvc.dibr.view_set import views_of_array
from dvc.geometry.camera_array import CameraArray, DisparityLabels
from dvc.metrics import psnr_db
from tests.dibr.scenes import LABELS, planes


@cache
def scene() -> CameraArray:
    return planes(96, 128)


def test_pooled_psnr_is_that_of_the_mean_squared_error() -> None:
    """(3.1): errors are averaged before the logarithm is taken."""
    truth = np.full((8, 8), 100, np.uint8)
    found = quality_of([truth + 1, truth + 3], [truth, truth])
    assert found.pooled_db == pytest.approx(10.0 * math.log10(255.0**2 / 5.0))
    assert found.mean_db == pytest.approx(10.0 * math.log10(255.0**2) - 5.0 * math.log10(9.0))
    assert quality_of([truth], [truth]).pooled_db == math.inf


@pytest.mark.parametrize("coder", [X264, X265], ids=lambda coder: coder.name)
def test_video_codes_two_frames(coder: VideoCoder) -> None:
    first, second = views_of_array(scene(), gray=True).pictures
    stream = list(encode_frames((first, first), coder, 20, 0))
    assert len(stream) == 2
    assert len(stream[1]) < len(stream[0]) / 10
    found = decode_frames(list(encode_frames((first, second), coder, 12, 2)), coder)
    assert psnr_db(found[0], first) > 45.0
    assert 40.0 < psnr_db(found[1], second) < psnr_db(found[0], first) + 1.0


def test_every_baseline_keeps_to_its_bytes() -> None:
    """Each takes at most the bytes that it may, and returns nothing if they are too few."""
    baselines = baselines_of(scene(), LABELS)
    assert len(baselines) == 7
    for baseline in baselines:
        result = baseline.best_within(4000)
        assert result is not None, baseline.name
        assert 2000 < result.num_bytes <= 4000, baseline.name
        assert 0.0 < result.split < 1.0
        assert baseline.best_within(40) is None, baseline.name


def test_right_disparities_are_worth_their_bytes() -> None:
    """With the true disparities the second view is rendered well; with none it is not."""
    views = views_of_array(scene(), gray=True)
    truth = np.full(views.shape, 2.0)
    truth[24:72, 42:84] = 6.0
    good, bad = (
        PictureAndDepth("", views, disparity, LABELS, JPEG2000).best_within(6000)
        for disparity in (truth, np.zeros(views.shape))
    )
    assert good is not None
    assert bad is not None
    assert good.quality.pooled_db > bad.quality.pooled_db + 3.0
    assert PictureAndDepth("", views, truth, DisparityLabels(0.0, 1.0, 8), AVIF).best_within(100) is None
