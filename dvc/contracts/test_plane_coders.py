"""Contract of a coder of planes, and an encoder that answers the requests of its decoder."""

from importlib.metadata import entry_points
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dvc import extensions
from dvc.slepian_wolf import (
    CRC_BITS,
    ParityRequest,
    PlaneCoder,
    PlaneResult,
    crc,
    drive,
    joint_check,
    side_by_side,
)

Bits = NDArray[np.uint8]


class PlaneSource:
    """Answers requests for planes of one frame, a run each, and counts the answered bits by kind."""

    def __init__(self, planes: Bits, coder: PlaneCoder) -> None:
        self._planes, self._coder = planes, coder
        self._parity: dict[tuple[int, int], Bits] = {}
        self.paid = dict.fromkeys(("crc", "parity", "uncoded", "joint"), 0)
        self._charged: dict[tuple[int, str], int] = {}
        self.asked: set[tuple[int, int]] = set()

    def answer(self, request: ParityRequest) -> Bits:
        """Answer a request, and check that no bit is requested twice."""
        key = request.run, request.kind
        assert request.start == self._charged.get(key, 0)
        self._charged[key] = request.start + request.count
        self.paid[request.kind] += request.count
        if request.kind == "joint":
            check = joint_check(np.stack([crc(self._planes[p], CRC_BITS) for p in request.positions]))
            return check[: request.count]
        source: Bits = self._planes[request.run]
        if request.kind == "crc":
            source = crc(source, CRC_BITS)
        elif request.kind == "parity":
            codes = range(request.code, self._coder.num_codes)
            source = np.concatenate([self._parity_of(request.run, code) for code in codes])
            assert bool(request.positions) == self._coder.by_positions
        if not request.positions:
            return source[request.start : request.start + request.count]
        size = self._planes.shape[1]
        positions = {(request.run, request.code * size + position) for position in request.positions}
        assert len(positions) == request.count
        assert not positions & self.asked
        self.asked |= positions
        return source[list(request.positions)]

    def _parity_of(self, plane: int, code: int) -> Bits:
        if (plane, code) not in self._parity:
            words = self._planes[plane].astype(np.uint64)
            parity = np.empty_like(words)
            self._coder.encode(code, words, parity)
            self._parity[plane, code] = (parity & np.uint64(1)).astype(np.uint8)
        return self._parity[plane, code]


def exchange(bits: Bits, llr_ch: NDArray[np.floating], coder: PlaneCoder) -> PlaneResult:
    """Decode a frame of one plane, and check that it pays for every bit once and in order."""
    source, decoder = PlaneSource(bits[None], coder), coder.decoder(bits.size)
    decoded = drive(decoder.decode(llr_ch, (0, 0)), source.answer)
    check = drive(decoder.check(0), source.answer)
    result = check.corrected.get(0, decoded)
    assert check.success
    assert check.crc_bits == source.paid["joint"]
    assert result.parity_bits == source.paid["parity"] + source.paid["uncoded"]
    assert result.crc_bits == source.paid["crc"] <= CRC_BITS
    return result


def noisy(
    rng: np.random.Generator, num_bits: int, probability: NDArray[np.float64] | float
) -> tuple[Bits, NDArray[np.float64]]:
    """Return a random plane, and LLRs of side information that differs from it with a probability."""
    bits = rng.integers(0, 2, num_bits, dtype=np.uint8)
    seen = bits ^ (rng.random(num_bits) < probability)
    confidence = np.log((1 - np.asarray(probability)) / np.asarray(probability))
    return bits, (1 - 2.0 * seen) * confidence


def comparable(result: PlaneResult) -> dict[str, Any]:
    """Return a decoded plane and its cost in a form that can be compared."""
    return vars(result) | {"bits": result.bits.tolist()}


class PlaneCoderContract:
    """Tests of a coder; a derived class defines the fixture `coder`."""

    def test_garbage_side_information_ends_exactly(self, coder: PlaneCoder) -> None:
        """LLRs that are independent of the bits cost at most two bits per bit."""
        for seed in range(25):
            rng = np.random.default_rng(seed)
            num_bits, spread = int(rng.integers(1, 121)), rng.uniform(0.0, 12.0)
            bits = rng.integers(0, 2, num_bits, dtype=np.uint8)
            result = exchange(bits, rng.normal(0, spread, num_bits), coder)
            assert result.parity_bits <= 2 * num_bits
            np.testing.assert_array_equal(result.bits, bits)

    def test_every_short_length_is_exact(self, coder: PlaneCoder) -> None:
        """Planes of every length up to 60 with fair side information are exact."""
        rng = np.random.default_rng(12)
        for num_bits in range(1, 61):
            bits, llr_ch = noisy(rng, num_bits, 0.1)
            np.testing.assert_array_equal(exchange(bits, llr_ch, coder).bits, bits)

    def test_right_and_sure_planes_cost_little(self, coder: PlaneCoder) -> None:
        """A plane with a right and sure prior costs its check and at most a few parities."""
        for bit in (0, 1):
            result = exchange(np.full(1584, bit, np.uint8), np.full(1584, 20.0) * (1 - 2 * bit), coder)
            assert result.parity_bits <= 20
            assert result.crc_bits <= 16

    def test_outliers_cost_little(self, coder: PlaneCoder) -> None:
        """A few bits that are wrong against an LLR of 20 cost some parity, not the plane."""
        bits = np.zeros(1584, np.uint8)
        bits[[3, 700, 701, 1500]] = 1
        result = exchange(bits, np.full(1584, 20.0), coder)
        assert 0 < result.parity_bits < 400
        np.testing.assert_array_equal(result.bits, bits)

    def test_used_decoders_are_like_fresh_ones(self, coder: PlaneCoder) -> None:
        """The same plane and side information lead to the same requests."""
        (bits, llr_ch), (other, llr_other) = (noisy(np.random.default_rng(k), 1584, 0.05) for k in (8, 9))
        used = coder.decoder(1584)
        drive(used.decode(llr_other, (0, 0)), PlaneSource(other[None], coder).answer)
        result = drive(used.decode(llr_ch, (0, 0)), PlaneSource(bits[None], coder).answer)
        assert comparable(result) == comparable(exchange(bits, llr_ch, coder))

    def test_planes_are_independent(self, coder: PlaneCoder) -> None:
        """Planes that are decoded in step request the same bits as each by itself."""
        planes = [noisy(np.random.default_rng(k), 1584, p) for k, p in enumerate((0.1, 0.01, 0.03))]
        source = PlaneSource(np.stack([bits for bits, _ in planes]), coder)
        decoder = coder.decoder(1584)
        steps = side_by_side([decoder.decode(llr, (0, n)) for n, (_, llr) in enumerate(planes)])
        together = drive(steps, lambda requests: [source.answer(request) for request in requests])
        for (bits, llr), result in zip(planes, together, strict=True):
            np.testing.assert_array_equal(result.bits, bits)
            assert comparable(result) == comparable(exchange(bits, llr, coder))

    def test_parity_is_linear(self, coder: PlaneCoder) -> None:
        """Parity of a sum is the sum of parities, and that of a plane is independent of other planes."""
        words = np.random.default_rng(1).integers(0, 2**64, (2, 300), dtype=np.uint64)
        for code in range(coder.num_codes):
            first, second, both, single = (np.empty(300, np.uint64) for _ in range(4))
            coder.encode(code, words[0], first)
            coder.encode(code, words[1], second)
            coder.encode(code, words[0] ^ words[1], both)
            np.testing.assert_array_equal(both, first ^ second)
            coder.encode(code, words[0] & np.uint64(1 << 17), single)
            np.testing.assert_array_equal(single, first & np.uint64(1 << 17))

    @pytest.mark.parametrize("seed", range(20))
    def test_damaged_answers_end(self, coder: PlaneCoder, seed: int) -> None:
        """Decoding ends after a bounded number of bits even if all answers are random."""
        rng = np.random.default_rng(seed)
        num_bits, counts = int(rng.integers(2, 81)), list[int]()
        decoder = coder.decoder(num_bits)

        def _answer(request: ParityRequest) -> Bits:
            assert list(request.positions) == sorted(set(request.positions))
            counts.append(request.count)
            return rng.integers(0, 2, request.count, dtype=np.uint8)

        for plane in range(3):
            drive(decoder.decode(rng.normal(1.0, 2.0, num_bits), (0, plane)), _answer)
        check = drive(decoder.check(0), _answer)
        assert sum(counts) <= 3 * (2 * num_bits + 200)
        assert len(check.corrected) <= 3


@pytest.mark.parametrize("group", extensions.GROUPS)
def test_names_can_be_in_streams(group: str) -> None:
    """Options and streams ignore all other names."""
    names = {entry.name for entry in entry_points(group=group)}
    ignored = sorted(names - set(extensions.installed(group)))
    assert not ignored, f"{group}: {ignored} do not match {extensions.NAME.pattern}"


class TestInstalledCoders(PlaneCoderContract):
    """Coders of planes that are installed."""

    @pytest.fixture(params=extensions.installed(extensions.PLANE_CODERS))
    def coder(self, request: pytest.FixtureRequest) -> PlaneCoder:
        """Return a coder."""
        coder: PlaneCoder = extensions.make(extensions.PLANE_CODERS, request.param, 1)
        return coder
