"""Tests of RSC trellises."""

import numpy as np
import pytest

from dvc.slepian_wolf.turbo.trellis import memory, step, trellis
from tests.reference.turbo_bcjr import rsc_encode


def test_textbook_impulse_response() -> None:
    """The (1, 5/7) code answers an impulse by 1110110..., the series of (1 + D^2) / (1 + D + D^2)."""
    state, parity = 0, []
    for bit in (1, 0, 0, 0, 0, 0, 0):
        state, emitted = step(state, bit, 0b111, 0b101)
        parity.append(emitted)
    assert parity == [1, 1, 1, 0, 1, 1, 0]


@pytest.mark.parametrize("polynomials", [(0b11, 0b01), (0b101, 0b111), (0b1101, 0b1011), (0b11001, 0b11011)])
def test_tables_encode_as_polynomials_divide(polynomials: tuple[int, int]) -> None:
    """Walking the tables gives the quotient of the polynomials."""
    bits = np.random.default_rng(3).integers(0, 2, 60, dtype=np.uint8)
    table = trellis(*polynomials)
    state, parity = 0, []
    for bit in bits:
        parity.append(table.output[state, bit])
        state = table.next_state[state, bit]
    np.testing.assert_array_equal(parity, rsc_encode(bits, *polynomials))


@pytest.mark.parametrize("polynomials", [(0b111, 0b101), (0b1011, 0b1101), (0b11001, 0b11011)])
def test_transitions_pair_up(polynomials: tuple[int, int]) -> None:
    """States k and k + S/2 lead to 2k and 2k + 1, and the masks name the transitions to the even one."""
    table = trellis(*polynomials)
    half = table.num_states // 2
    for state in range(table.num_states):
        bit = table.input_mask >> state & 1
        assert table.next_state[state, bit] == 2 * (state % half)
        assert table.next_state[state, 1 - bit] == 2 * (state % half) + 1
        assert table.output[state, bit] == table.parity_mask >> state & 1
        assert table.output[state, 1 - bit] == 1 - (table.parity_mask >> state & 1)


@pytest.mark.parametrize("polynomials", [(0b110, 0b101), (0b111, 0b100), (1, 0b11), (0b100101, 1), (1, 1)])
def test_refuses_what_is_no_code(polynomials: tuple[int, int]) -> None:
    """Polynomials without constant term, without feedback, or too long are refused."""
    with pytest.raises(ValueError, match=r"constant term|register length|oldest"):
        memory(*polynomials)
