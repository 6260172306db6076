"""Needs of streams without feedback are fitted to what frames were found to need."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.searches.rate_needs import _fit_bits, fit
from dvc.config import VideoConfig, codec_config
from dvc.wynerziv import quantizer
from dvc.wynerziv.payloads import quantize_frame
from dvc.wynerziv.quantizer import FrameLayout
from encoder.rate_control.needs import NEEDS, OCTAVES, NeedEstimator
from encoder.rate_control.sampled_blocks import BlockErrors

RNG = np.random.default_rng(4)
CONFIG = codec_config(VideoConfig(352, 288, 25, 1, luma_only=True))


def test_a_curve_is_found_again() -> None:
    """From sums over many coefficients, some of them far off; clips count alike."""
    curve = np.array(NEEDS[0].bits)
    design = RNG.dirichlet(np.full(len(OCTAVES), 0.3), 200) * 6336
    bits = design @ curve
    bits[:6] *= 3.0
    found, deviations = _fit_bits(design, bits, np.ones(200))
    np.testing.assert_allclose(found, curve, rtol=0.15, atol=0.03)
    assert np.abs(np.median(deviations)) < 0.05
    assert (deviations[:6] < -0.5).all()


def recorded(clip: str) -> Any:
    """Return a frame whose planes of DC need what `NEEDS` tell, and whose error is what they expect."""
    layout = FrameLayout(288, 352, True, (0,) * 16, 16)
    luma = RNG.integers(0, 256, (288, 352), dtype=np.uint8)
    quantization, _ = quantize_frame(layout, luma, quantizer.index_of_step(20.0))
    shape, needs = (16, 40), NEEDS[0]
    residual, noise = (
        scale * RNG.lognormal(0.0, 1.0, shape) * RNG.uniform(0.2, 5.0) for scale in (300.0, 9.0)
    )
    errors = BlockErrors(residual.astype(np.float32), noise.astype(np.float32))
    costs = NeedEstimator(CONFIG, 0).choose(quantization, errors, 4, layout.num_bits).costs
    squares = needs.variance[0] * residual[0].mean() + needs.variance[1] * noise[0].mean()
    left = np.full(quantization.planes[0], 1.0)
    return SimpleNamespace(
        clip=clip,
        distance=4,
        errors=errors,
        encoded=SimpleNamespace(quantization=quantization, layout=layout),
        bits={0: costs[0, 0, : quantization.planes[0] + 1]},
        squares={0: layout.num_bits * np.concatenate([[squares], left])},
        slope=50.0,
    )


def test_needs_are_found_again() -> None:
    """Shares of residual and noise, and bits where there are any coefficients; nothing is off on the mean."""
    needs, deviations = fit([recorded(clip) for clip in ("one", "other") for _ in range(12)], 0)
    np.testing.assert_allclose(needs.variance, NEEDS[0].variance, rtol=0.05)
    np.testing.assert_allclose(needs.bits[4:8], NEEDS[0].bits[4:8], rtol=0.1)
    assert sorted(deviations) == ["one", "other"]
    assert all(abs(logs.mean()) < 0.03 for logs in deviations.values())
