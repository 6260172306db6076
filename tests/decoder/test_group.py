"""Groups of pictures decoded in memory."""

from dataclasses import replace

import numpy as np
import pytest

from decoder.group import GroupDecoder, single_prediction
from decoder.side_information.protocol import Prediction
from dvc.config import VideoConfig, codec_config
from dvc.errors import BitstreamError, DvcError


def test_unknown_methods_are_refused() -> None:
    """A stream that names a method of the future is refused by name."""
    config = codec_config(VideoConfig(16, 16, 25, 1), side_information={"method": "magic"})
    with pytest.raises(BitstreamError, match="'magic' is not installed; there are mci"):
        GroupDecoder(config)


def predicted(value: float = 7.0, shape: tuple[int, int] = (3, 5)) -> Prediction:
    """Return a prediction of one value."""
    return Prediction(np.full(shape, value), None, (np.zeros((3, 5)),), "of others")


@pytest.mark.parametrize(
    ("found", "told"),
    [
        (None, "expected a list of one prediction for one instant"),
        ([], "expected a list of one prediction for one instant"),
        ([np.zeros((3, 5))], "expected a list of one prediction for one instant"),
        ([predicted(shape=(2, 5))], "expected predictions of 5x3, got 5x2"),
        ([predicted(np.nan)], "a prediction is not finite"),
        ([replace(predicted(), compensated=())], "expected a compensated reference at least"),
        ([replace(predicted(), luma=[7.0])], "expected arrays, got list"),
        ([replace(predicted(), alternatives=(np.zeros((1, 5)),))], "expected predictions of 5x3, got 5x1"),
        ([replace(predicted(), expected_error=np.zeros(15))], "expected predictions of 5x3, got 15"),
    ],
)
def test_a_method_of_others_that_errs_is_named(found: object, told: str) -> None:
    """In one line, whatever it returns; what is right passes."""
    good = predicted()
    assert single_prediction([good], (3, 5), "mine") is good
    with pytest.raises(DvcError) as caught:
        single_prediction(found, (3, 5), "mine")
    assert str(caught.value) == f"side information 'mine': {told}"
