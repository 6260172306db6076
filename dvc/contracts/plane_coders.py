"""What every coder of planes must do, whatever it is given."""

from typing import Any

import numpy as np
import pytest

from dvc.contracts.plane_exchange import Bits, PlaneSource, exchange, noisy
from dvc.slepian_wolf import ParityRequest, PlaneCoder, PlaneResult, drive, side_by_side


def told(result: PlaneResult) -> dict[str, Any]:
    """Return a decoded plane and what it cost as what can be compared."""
    return vars(result) | {"bits": result.bits.tolist()}


class PlaneCoderContract:
    """Tests of a coder; a class derived from this one says which, by the fixture `coder`."""

    def test_garbage_side_information_ends_exactly(self, coder: PlaneCoder) -> None:
        """LLRs that have nothing to do with the bits cost at most two bits per bit."""
        for seed in range(25):
            rng = np.random.default_rng(seed)
            num_bits, spread = int(rng.integers(1, 121)), rng.uniform(0.0, 12.0)
            bits = rng.integers(0, 2, num_bits, dtype=np.uint8)
            result = exchange(bits, rng.normal(0, spread, num_bits), coder)
            assert result.parity_bits <= 2 * num_bits
            np.testing.assert_array_equal(result.bits, bits)

    def test_every_short_length_comes_back(self, coder: PlaneCoder) -> None:
        """Planes of every length up to 60 with fair side information are exact."""
        rng = np.random.default_rng(12)
        for num_bits in range(1, 61):
            bits, llr_ch = noisy(rng, num_bits, 0.1)
            np.testing.assert_array_equal(exchange(bits, llr_ch, coder).bits, bits)

    def test_right_and_sure_planes_cost_little(self, coder: PlaneCoder) -> None:
        """A plane that the prior is right and sure about costs its check and a few parities at most."""
        for bit in (0, 1):
            result = exchange(np.full(1584, bit, np.uint8), np.full(1584, 20.0) * (1 - 2 * bit), coder)
            assert result.parity_bits <= 20
            assert result.crc_bits <= 16

    def test_sure_side_information_with_outliers(self, coder: PlaneCoder) -> None:
        """A few bits that are wrong against an LLR of 20 cost some parity, not the plane."""
        bits = np.zeros(1584, np.uint8)
        bits[[3, 700, 701, 1500]] = 1
        result = exchange(bits, np.full(1584, 20.0), coder)
        assert 0 < result.parity_bits < 400
        np.testing.assert_array_equal(result.bits, bits)

    def test_hopeless_planes_are_sent_plainly(self, coder: PlaneCoder) -> None:
        """Where the prior says nothing the plane is requested as it is, without any check."""
        bits = np.random.default_rng(1).integers(0, 2, 400, dtype=np.uint8)
        result = exchange(bits, np.zeros(400), coder)
        assert (result.parity_bits, result.crc_bits, result.num_requests) == (400, 0, 1)

    def test_a_decoder_repeats_itself(self, coder: PlaneCoder) -> None:
        """The same plane and side information give the same requests to a fresh and to a used decoder."""
        (bits, llr_ch), (other, of_other) = (noisy(np.random.default_rng(k), 1584, 0.05) for k in (8, 9))
        used = coder.decoder(1584)
        drive(used.decode(of_other, (0, 0)), PlaneSource(other[None], coder).answer)
        first = drive(used.decode(llr_ch, (0, 0)), PlaneSource(bits[None], coder).answer)
        assert told(first) == told(exchange(bits, llr_ch, coder))

    def test_planes_side_by_side_are_as_alone(self, coder: PlaneCoder) -> None:
        """Planes that are decoded in step ask for what each asks for alone."""
        drawn = [noisy(np.random.default_rng(k), 1584, p) for k, p in enumerate((0.1, 0.01, 0.03))]
        source = PlaneSource(np.stack([bits for bits, _ in drawn]), coder)
        decoder = coder.decoder(1584)
        steps = side_by_side([decoder.decode(llr, (0, n)) for n, (_, llr) in enumerate(drawn)])
        together = drive(steps, lambda requests: [source.answer(own) for own in requests])
        for (bits, llr), result in zip(drawn, together, strict=True):
            np.testing.assert_array_equal(result.bits, bits)
            assert told(result) == told(exchange(bits, llr, coder))

    def test_frames_of_planes_of_all_entropies(self, coder: PlaneCoder) -> None:
        """With the check of the frame, all planes come back, and cost little more than their entropy."""
        rng = np.random.default_rng(6)
        decoder = coder.decoder(1584)
        paid = ideal = 0.0
        for frame in range(2):
            drawn = [noisy(rng, 1584, p) for p in (0.15, 0.06, 0.02, 0.01, 0.004, 0.002)]
            source = PlaneSource(np.stack([bits for bits, _ in drawn]), coder)
            results = [
                drive(decoder.decode(llr, (frame, n)), source.answer) for n, (_, llr) in enumerate(drawn)
            ]
            check = drive(decoder.check(frame), source.answer)
            assert check.success
            for n, (bits, _) in enumerate(drawn):
                np.testing.assert_array_equal(check.corrected.get(n, results[n]).bits, bits)
            paid += sum(source.paid.values())
            ideal += sum(result.ideal_bits for result in results)
        assert paid < (1.5 if coder.by_positions else 1.8) * ideal

    def test_parity_is_linear_and_planes_do_not_meet(self, coder: PlaneCoder) -> None:
        """Parity of a sum is the sum of parities, and that of a plane does not depend on those beside it."""
        rng = np.random.default_rng(1)
        words = rng.integers(0, 2**64, (2, 300), dtype=np.uint64)
        for code in range(coder.num_codes):
            first, second, both, alone = (np.empty(300, np.uint64) for _ in range(4))
            coder.encode(code, words[0], first)
            coder.encode(code, words[1], second)
            coder.encode(code, words[0] ^ words[1], both)
            np.testing.assert_array_equal(both, first ^ second)
            coder.encode(code, words[0] & np.uint64(1 << 17), alone)
            np.testing.assert_array_equal(alone, first & np.uint64(1 << 17))

    @pytest.mark.parametrize("seed", range(20))
    def test_answers_that_fit_no_plane_end(self, coder: PlaneCoder, seed: int) -> None:
        """Whatever a damaged payload answers, decoding ends after a bounded number of bits."""
        rng = np.random.default_rng(seed)
        num_bits = int(rng.integers(2, 81))
        decoder = coder.decoder(num_bits)
        total = 0

        def answer(request: ParityRequest) -> Bits:
            nonlocal total
            positions = request.positions
            assert list(positions) == sorted(set(positions))
            total += request.count
            return rng.integers(0, 2, request.count, dtype=np.uint8)

        for plane in range(3):
            drive(decoder.decode(rng.normal(1.0, 2.0, num_bits), (0, plane)), answer)
        check = drive(decoder.check(0), answer)
        assert total <= 3 * (2 * num_bits + 200)
        assert len(check.corrected) <= 3

    @pytest.mark.parametrize(
        "wrong", [lambda n: np.zeros(n + 1, "u1"), np.zeros, lambda n: np.full(n, 2, "u1")]
    )
    def test_wrong_answers_are_refused(self, coder: PlaneCoder, wrong: object) -> None:
        """Bits of the wrong number, type or value end the coroutine."""
        coroutine = coder.decoder(50).decode(np.full(50, 2.0), (0, 0))
        request = next(coroutine)
        with pytest.raises(ValueError, match=f"expected {request.count} {request.kind} bits"):
            coroutine.send(wrong(request.count))  # type: ignore[operator]

    @pytest.mark.parametrize("llr_ch", [np.zeros((2, 3)), np.array([np.nan]), np.zeros(0)])
    def test_side_information_must_be_a_vector_of_numbers(
        self, coder: PlaneCoder, llr_ch: np.ndarray
    ) -> None:
        """Other shapes and NaN are refused."""
        with pytest.raises(ValueError, match="llr_ch"):
            next(coder.decoder(4).decode(llr_ch, (0, 0)))
