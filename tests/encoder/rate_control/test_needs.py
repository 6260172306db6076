"""What is sent: more where more is left to be told, and never more than there is."""

from itertools import pairwise

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.config import Qp, VideoConfig, codec_config
from dvc.wynerziv import quantizer
from dvc.wynerziv.lengths import LONGEST, length_of_code
from dvc.wynerziv.payloads import quantize_frame
from dvc.wynerziv.quantizer import FrameLayout
from encoder.rate_control import _kernels
from encoder.rate_control.needs import NEEDS, Choice, NeedEstimator
from encoder.rate_control.sampled_blocks import BlockErrors

CONFIG = codec_config(VideoConfig(352, 288, 25, 1, luma_only=True), quality=Qp(28))
LAYOUT = FrameLayout.of(CONFIG)
LUMA = np.random.default_rng(1).integers(0, 256, (288, 352), dtype=np.uint8)
QUANTIZATIONS = {
    distance: quantize_frame(LAYOUT, LUMA, quantizer.index_of_step(CONFIG.wyner_ziv.step(distance)))[0]
    for distance in (2, 3, 4, 8, 16, 32, 256)
}
QUANTIZATION = QUANTIZATIONS[4]


def errors(residual: float, noise: float = 0.0) -> BlockErrors:
    """Return errors that are the same everywhere, given by their roots."""
    return BlockErrors(*(np.full((16, 48), root**2, np.float32) for root in (residual, noise)))


def chosen(expected: BlockErrors, margin_percent: int = 30, distance: int = 4) -> Choice:
    """Choose what is sent; no more planes than there are."""
    quantization = QUANTIZATIONS[distance]
    choice = NeedEstimator(CONFIG, margin_percent).choose(quantization, expected, distance, LAYOUT.num_bits)
    pairs = zip(choice.sent.depths, quantization.planes, strict=True)
    assert all(depth <= planes for depth, planes in pairs)
    return choice


def sizes(choice: Choice) -> tuple[int, int]:
    """Return planes and bits that are sent."""
    return sum(choice.sent.depths), sum(map(length_of_code, choice.sent.length_codes))


def test_larger_errors_need_more() -> None:
    """More planes, and longer syndromes; nothing where there is nothing to tell; noise is an error, too."""
    found = [sizes(chosen(errors(residual))) for residual in (0.0, 20.0, 40.0, 80.0)]
    assert found[0] == (0, 0)
    assert found == sorted(found)
    assert found[1][1] < found[2][1] < found[3][1]
    assert sizes(chosen(errors(20.0, 40.0))) > found[1]


CHOICES = {
    (5.0, 2): (0, 0, 0, 0),
    (6.0, 2): (0, 0, 0, 0),
    (7.0, 2): (0, 0, 0, 0),
    (8.0, 2): (0, 0, 0, 0),
    (9.0, 2): (4, 0, 1984, 0),
    (10.0, 2): (4, 58, 2304, 960),
    (16.0, 2): (5, 43, 6144, 960),
    (24.0, 2): (5, 28, 10240, 960),
    (64.0, 2): (5, 73, 22528, 147456),
    (5.0, 8): (0, 0, 0, 0),
    (6.0, 8): (4, 0, 2304, 0),
    (8.0, 8): (4, 0, 2944, 0),
    (9.0, 8): (5, 45, 5888, 1024),
    (20.0, 8): (5, 30, 13312, 1024),
    (24.0, 8): (5, 30, 15872, 1024),
    (16.0, 16): (5, 37, 12800, 1088),
}
"""By residual and distance of the references: planes of DC and of the others, and bits of their syndromes."""


@pytest.mark.parametrize(("residual", "distance"), CHOICES)
def test_choices_are_those_that_were_measured(residual: float, distance: int) -> None:
    """What pays, and how much margin what predicts others gets, is as it was when rates were measured."""
    sent = chosen(errors(residual), distance=distance).sent
    lengths = tuple(map(length_of_code, sent.length_codes))
    assert (sent.depths[0], sum(sent.depths[1:]), *lengths) == CHOICES[residual, distance]


def test_coarse_errors_cost_a_bit_for_each_doubling() -> None:
    """Of each coefficient, beyond the octaves at which bits were measured."""
    roots = 2000.0, 4000.0, 8000.0
    costs = [chosen(errors(root)).costs[0, 0] for root in roots]
    for fewer, more in pairwise(costs):
        np.testing.assert_allclose((more - fewer)[-2:] / LAYOUT.num_bits, 1.0, rtol=0.01)


def test_margins_lengthen_syndromes_alone() -> None:
    """Up to what the planes hold."""
    planes, bits = zip(*(sizes(chosen(errors(40.0), margin)) for margin in (0, 60, 1000)), strict=True)
    assert len(set(planes)) == 1
    assert bits[0] < bits[1] < bits[2]
    assert bits[1] / bits[0] == pytest.approx(1.6, rel=0.1)


def test_huge_margins_send_nothing_that_does_not_pay() -> None:
    """At most a tenth more than the planes."""
    planes, bits = sizes(chosen(errors(60.0), 10**9))
    assert bits < 1.3 * planes * LAYOUT.num_bits


@pytest.mark.parametrize("distance", QUANTIZATIONS)
def test_every_distance_has_its_needs(distance: int) -> None:
    """However far apart references are."""
    planes, bits = sizes(chosen(errors(40.0), distance=distance))
    assert planes > 0
    assert bits > 0


def test_what_is_sent_lessens_the_noise() -> None:
    """Of the frame as a reference: as much as the planes tell, and not where nothing is sent."""
    rough, fine = chosen(errors(40.0)), chosen(errors(0.2))
    assert rough.noise[0].max() < 0.2 * 40.0**2 * NEEDS[0].variance[0]
    np.testing.assert_allclose(fine.noise[0], NEEDS[0].variance[0] * 0.04 + NEEDS[0].variance[2], rtol=0.07)


def test_pictures_without_whole_blocks_are_sent_as_if_unknown() -> None:
    """What cannot be estimated is expected to be large."""
    choice = chosen(BlockErrors(np.empty((16, 0)), np.empty((16, 0))), distance=2)
    assert choice.sent.depths[0] == QUANTIZATION.planes[0]


def test_large_blocks_need_less_for_each_bit() -> None:
    """Never less than their ideal code length; nothing where there is nothing to tell."""
    per_bit = [_kernels.shortest_length(bits) / bits for bits in (100.0, 1000.0, 10000.0)]
    assert per_bit[0] > per_bit[1] > per_bit[2] > 1.0
    assert _kernels.shortest_length(0.0) == 0.0


@pytest.mark.nojit
def test_what_dc_tells_refines_the_other_bands() -> None:
    """By a share of their mean residual once all is told, by none before anything is; as in plain code."""
    residual = np.random.default_rng(3).uniform(0.0, 900.0, (15, 30)).astype(np.float32)
    squares = np.array([1000.0, 640.0, 90.0, 0.0])
    ours, twin = squares.copy(), squares.copy()
    _kernels.refine(ours, residual, 0.5)
    python_twin(_kernels.refine)(twin, residual, 0.5)
    most = 0.5 * residual.mean(axis=1, dtype=np.float64).sum()
    np.testing.assert_allclose(ours, squares - most * np.sqrt(1.0 - squares / 1000.0))
    np.testing.assert_allclose(ours, twin, rtol=1e-12)


@pytest.mark.nojit
def test_kernels_are_their_python() -> None:
    """To the last bit."""
    rng = np.random.default_rng(2)
    residual, noise = rng.uniform(0.0, 900.0, (16, 30)) ** 2, rng.uniform(0.0, 9.0, (16, 30))
    expected = BlockErrors(residual.astype(np.float32), noise.astype(np.float32))
    jit = chosen(expected)
    with pytest.MonkeyPatch.context() as patch:
        for name in ("variance_places", "expected_costs", "frame_costs", "remaining_noise", "least_depths"):
            patch.setattr(_kernels, name, python_twin(getattr(_kernels, name)))
        for name in ("shortest_length", "choose_planes", "choose"):
            patch.setattr(_kernels, name, python_twin(getattr(_kernels, name)))
        plain = chosen(expected)
    assert jit.sent == plain.sent
    np.testing.assert_array_equal(jit.noise, plain.noise)
    np.testing.assert_array_equal(jit.costs, plain.costs)
    assert jit.noise.all()
    assert min(jit.sent.length_codes) > 0


def test_no_block_is_sent_that_the_longest_syndrome_does_not_serve() -> None:
    """Pictures may be so large, and predictions so bad, that a byte cannot tell what a block needs."""
    estimator, residual = NeedEstimator(CONFIG, 30), errors(60.0).residual
    expected, half = BlockErrors(residual, np.zeros_like(residual)), 1 << 17
    fits, larger = (estimator.choose(QUANTIZATION, expected, 256, count) for count in (half, 4 * half))
    assert LONGEST / 4 < length_of_code(fits.sent.length_codes[0]) < LONGEST
    assert larger.sent.length_codes[0] == larger.sent.depths[0] == 0
