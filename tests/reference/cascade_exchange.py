"""Planes coded by parities of ranges from end to end: an encoder that answers the requests of a decoder."""

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import ParityRequest, crc, joint_check
from dvc.slepian_wolf.cascade.orders import bit_orders

Bits = NDArray[np.uint8]
SEED = 1


class PlaneSource:
    """Answers requests for planes of one frame, and counts what it answers by kind."""

    def __init__(self, planes: Bits, crc_bits: int = 16) -> None:
        self._planes = planes
        self._crc_bits = crc_bits
        self.paid = dict.fromkeys(("crc", "parity", "uncoded", "joint"), 0)
        self._charged: dict[tuple[int, str], int] = {}
        self.asked: set[tuple[int, int, int]] = set()

    def answer(self, request: ParityRequest) -> Bits:
        key = request.plane, request.kind
        assert request.start == self._charged.get(key, 0)
        self._charged[key] = request.start + request.count
        self.paid[request.kind] += request.count
        if request.kind == "joint":
            check = joint_check(np.stack([crc(self._planes[p], self._crc_bits) for p in request.positions]))
            return check[: request.count]
        bits = self._planes[request.plane]
        if request.kind == "parity":
            orders, positions = np.divmod(np.array(request.positions), bits.size)
            orders += request.code
            wanted = {
                (request.plane, *place) for place in zip(orders.tolist(), positions.tolist(), strict=True)
            }
            assert len(wanted) == request.count
            assert not wanted & self.asked
            self.asked |= wanted
            parities = np.cumsum(bits[bit_orders(bits.size, SEED)[0]], axis=1) % 2
            return parities[orders, positions].astype(np.uint8)
        source = crc(bits, self._crc_bits) if request.kind == "crc" else bits
        return source[request.start : request.start + request.count]
