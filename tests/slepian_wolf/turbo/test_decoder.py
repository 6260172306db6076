"""Tests of iterative decoding."""

import numpy as np
import pytest

from dvc.contracts.plane_exchange import noisy
from dvc.slepian_wolf.turbo.codes import CLASSICAL
from dvc.slepian_wolf.turbo.decoder import TurboDecoder
from dvc.slepian_wolf.turbo.encoder import encode_planes
from tests.coders import SEED


def _crossover(entropy: float) -> float:
    """Invert the binary entropy by bisection."""
    low, high = 1e-6, 0.5
    for _ in range(60):
        p = (low + high) / 2
        if -p * np.log2(p) - (1 - p) * np.log2(1 - p) < entropy:
            low = p
        else:
            high = p
    return low


@pytest.mark.parametrize("entropy", [0.06, 0.2, 0.5])
def test_corrects_its_channel(entropy: float) -> None:
    """With enough parity for a channel, decoding succeeds."""
    bits, llr_ch = noisy(np.random.default_rng(4), 1584, _crossover(entropy))
    parity = encode_planes(bits[None], CLASSICAL, SEED)[0]
    decoder = TurboDecoder(CLASSICAL, 1584, SEED)
    decoder.start(llr_ch)
    decoder.add_parity(parity[: min(1584, round((2.5 if entropy < 0.13 else 1.6) * entropy * 1584))])
    assert not decoder.parity_satisfied
    assert decoder.iterate(60) < 60
    assert decoder.parity_satisfied
    np.testing.assert_array_equal(decoder.decisions, bits)
    decoder.polish(5)
    assert decoder.expected_errors < 1


def test_goes_on_when_parity_arrives() -> None:
    """Parity that comes in pieces ends in the same decisions, and a restart repeats every number."""
    bits, llr_ch = noisy(np.random.default_rng(5), 1584, 0.07)
    parity = encode_planes(bits[None], CLASSICAL, SEED)[0]
    decoder = TurboDecoder(CLASSICAL, 1584, SEED)
    runs = []
    for _ in range(2):
        decoder.start(llr_ch)
        trace = []
        for first in range(0, 900, 100):
            decoder.add_parity(parity[first : first + 100])
            trace.append(decoder.iterate(5))
        runs.append((trace, decoder.decisions.copy()))
        assert decoder.num_parity == 900
        np.testing.assert_array_equal(decoder.decisions, bits)
    assert runs[0][0] == runs[1][0]
    np.testing.assert_array_equal(runs[0][1], runs[1][1])


@pytest.mark.parametrize("bit", [0, 1])
def test_constant_planes(bit: int) -> None:
    """Planes of zeros and of ones are planes like others."""
    bits = np.full(300, bit, np.uint8)
    decoder = TurboDecoder(CLASSICAL, 300, SEED)
    decoder.start(np.where(np.random.default_rng(1).random(300) < 0.1, -2.2, 2.2) * (1 - 2 * bit))
    decoder.add_parity(encode_planes(bits[None], CLASSICAL, SEED)[0, :240])
    decoder.iterate(40)
    np.testing.assert_array_equal(decoder.decisions, bits)


def test_refuses_bad_arguments() -> None:
    """LLRs and parity are checked for shape and value."""
    decoder = TurboDecoder(CLASSICAL, 20, SEED)
    with pytest.raises(ValueError, match="20 numbers"):
        decoder.start(np.zeros(19))
    with pytest.raises(ValueError, match="20 numbers"):
        decoder.start(np.full(20, np.nan))
    decoder.start(np.full(20, np.inf))
    with pytest.raises(ValueError, match="at most 20"):
        decoder.add_parity(np.zeros(21, np.uint8))
    decoder.add_parity(np.zeros(4, np.uint8))
    with pytest.raises(ValueError, match="at most 16"):
        decoder.add_parity(np.zeros(17, np.uint8))
    with pytest.raises(ValueError, match="0 and 1"):
        decoder.add_parity(np.full(3, 2, np.uint8))
