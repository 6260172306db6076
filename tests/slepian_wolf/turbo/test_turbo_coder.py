"""Acceptance of a plane: how many check bits are asked for, and when it is given up."""

from collections.abc import Sequence

import numpy as np
import pytest

from dvc.slepian_wolf.checks import CRC_BITS, crc
from dvc.slepian_wolf.turbo.turbo_coder import ERROR_EXPONENT, DecoderPool, _Plane
from dvc.slepian_wolf.turbo.turbo_decoder import TurboDecoder
from dvc.slepian_wolf.turbo.turbo_encoder import CLASSICAL

BITS = np.random.default_rng(1).integers(0, 2, 64, dtype=np.uint8)


def accepted(plane: _Plane, check: np.ndarray, expected_errors: float) -> tuple[bool, Sequence[int]]:
    """Answer what is asked for from a check; return the verdict, and how many bits each request was for."""
    asking, counts, answer = plane.accept(BITS, expected_errors), list[int](), None
    try:
        while True:
            request = asking.send(answer) if answer is not None else next(asking)
            counts.append(request.count)
            answer = check[request.start : request.start + request.count]
    except StopIteration as end:
        return end.value, counts


def plane_of(num_check_bits: int, size_of_llr: float = 8.0) -> _Plane:
    """Return a plane of which the decisions are likely, with the first bits of its check."""
    plane = _Plane((0, 0), np.where(BITS, -size_of_llr, size_of_llr).astype(np.float32))
    plane.check = crc(BITS, CRC_BITS)[:num_check_bits]
    plane.parity = np.zeros(64, np.uint8)
    return plane


def test_sure_planes_need_no_more_bits() -> None:
    """As soon as the check that there is bears the odds."""
    assert accepted(plane_of(CRC_BITS), crc(BITS, CRC_BITS), 2.0**-9) == (True, [])


@pytest.mark.parametrize("exponent", [0, 3])
def test_open_planes_ask_for_what_is_missing(exponent: int) -> None:
    """A bit for each halving of the odds; what does not agree then is refused."""
    missing = int(ERROR_EXPONENT) - exponent - 6
    check = crc(BITS, CRC_BITS)
    assert accepted(plane_of(6), check, 2.0**-exponent) == (True, [missing])
    assert accepted(plane_of(6), 1 - check, 2.0**-exponent) == (False, [missing])


def test_hopeless_planes_are_given_up() -> None:
    """Where even the whole check would not bear the odds, or what there is disagrees."""
    assert accepted(plane_of(6), crc(BITS, CRC_BITS), 2.0 ** (CRC_BITS - ERROR_EXPONENT + 1)) == (False, [])
    plane = plane_of(6)
    plane.check = 1 - plane.check
    assert accepted(plane, crc(BITS, CRC_BITS), 1.0) == (False, [])


def test_decoders_are_made_if_none_is_idle_and_come_back() -> None:
    """Two loans at once need two decoders; a later loan, or one after a failure, gets one of these."""
    made: list[TurboDecoder] = []

    def make() -> TurboDecoder:
        made.append(TurboDecoder(CLASSICAL, 64, 1))
        return made[-1]

    pool = DecoderPool(make)
    with pool.lent() as first, pool.lent() as second:
        assert first is not second
    with pytest.raises(KeyError), pool.lent():
        raise KeyError
    with pool.lent() as third, pool.lent() as fourth:
        assert third is not fourth
    assert len(made) == 2
