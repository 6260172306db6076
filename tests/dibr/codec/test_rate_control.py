"""The search for the slope of a rate."""

import numpy as np
import pytest

from dvc.dibr.codec.encoder import Encoded, ViewEncoder
from dvc.dibr.codec.rate_control import MAX_STEPS, TOLERANCE, encode_to_size
from dvc.dibr.codec.views import Views
from dvc.errors import ConfigError
from dvc.multiview.camera_array import DisparityLabels, LatticePosition


class _Curve:
    """Streams whose length falls with the root of the slope; counts how many are made."""

    def __init__(self, grain=1):
        self.count, self.grain = 0, grain

    def __call__(self, slope):
        self.count += 1
        size = 60 + int(900.0 / slope**0.5) // self.grain * self.grain
        return Encoded(bytes(size), slope, 40, size - 60, 20)


@pytest.mark.parametrize("max_bytes", [500, 5000, 50_000, 500_000])
@pytest.mark.parametrize("first_slope", [1e-6, 2e-3, 1.0])
def test_streams_are_as_long_as_they_may_be(max_bytes, first_slope):
    curve = _Curve()
    found = encode_to_size(curve, max_bytes, first_slope)
    assert (1.0 - TOLERANCE) * max_bytes <= len(found.data) <= max_bytes
    assert curve.count <= MAX_STEPS + 1


def test_lengths_in_steps_end_below_the_rate():
    found = encode_to_size(_Curve(grain=7000), 30_000)
    assert len(found.data) == 28_060


def test_rates_below_the_shortest_stream_are_refused():
    with pytest.raises(ConfigError, match="100 bytes are too few: these views need 344 at least"):
        encode_to_size(_Curve(), 100)


def test_likely_slopes_give_about_the_length_that_was_asked():
    generator = np.random.default_rng(0)
    picture = np.kron(generator.integers(0, 256, (12, 16)), np.ones((4, 4))).astype(np.uint8)
    views = Views((picture, np.roll(picture, -2, axis=1)), (LatticePosition(0, 0), LatticePosition(1, 0)))
    encoder = ViewEncoder(views, DisparityLabels(0.0, 1.0, 4))
    for num_bytes in (400, 800):
        pictures = sum(code.bytes_at_slope(encoder.likely_slope(num_bytes)) for code in encoder.codes)
        assert 0.5 * num_bytes < pictures <= 0.85 * num_bytes
