"""What the turbo figures rest on: a plain SISO decoder, and planes that are coded and decoded."""

import numpy as np
import pytest

from benchmarks.figures import turbo
from dvc.slepian_wolf import SlepianWolfSettings
from dvc.slepian_wolf.turbo.siso import siso


@pytest.mark.parametrize("polynomials", [(0b111, 0b101), (0b11001, 0b11011)])
def test_plain_siso_agrees_with_the_compiled_one(polynomials: tuple[int, int]) -> None:
    """Both give the same extrinsic LLRs, with parity known at some steps."""
    rng = np.random.default_rng(5)
    llr_a = rng.normal(0, 3, 120)
    parity = np.where(rng.random(120) < 0.4, rng.integers(0, 2, 120), -1).astype(np.int8)
    plain = turbo.plain_siso(llr_a, parity, *polynomials)
    np.testing.assert_allclose(siso(llr_a, parity, *polynomials), np.clip(plain, -20, 20), atol=0.02)


@pytest.mark.parametrize("probability", [0.0005, 0.07, 0.45])
def test_planes_are_decoded(probability: float) -> None:
    """A plane comes back exactly, with little noise and with so much that it is sent plainly."""
    bits, llr_ch = turbo.noisy_plane(300, probability, np.random.default_rng(2))
    result = turbo.decode_plane(bits, llr_ch, SlepianWolfSettings(), seed=1)
    assert result.success
    np.testing.assert_array_equal(result.bits, bits)
    assert result.parity_bits <= 300


def test_entropy_is_symmetric() -> None:
    """A fair coin has one bit, and p and 1 - p have the same entropy."""
    assert turbo.entropy(0.5) == 1.0
    assert turbo.entropy(0.1) == pytest.approx(turbo.entropy(0.9))
