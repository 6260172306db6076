"""Picture coders at a number of bytes."""

import numpy as np
import pytest
from skimage.data import camera

from benchmarks.baselines.picture_coders import AVIF, JPEG2000, Ladder, PictureCoder
from dvc.metrics import psnr_db

PICTURE = np.ascontiguousarray(camera()[100:228, 200:356])


@pytest.mark.parametrize("coder", [AVIF, JPEG2000], ids=lambda coder: coder.name)
def test_best_quality_that_fits(coder: PictureCoder) -> None:
    ladder = Ladder(coder, PICTURE)
    qualities = []
    for max_bytes in (1000, 4000):
        found = ladder.within(max_bytes)
        assert found is not None
        assert found.num_bytes <= max_bytes < ladder.at(found.level + 1).num_bytes
        assert found.picture.shape == PICTURE.shape
        qualities.append(psnr_db(found.picture, PICTURE))
    assert qualities[1] > qualities[0] + 3.0
    assert ladder.within(10) is None
