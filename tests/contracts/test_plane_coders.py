"""Our coders of planes keep the contract, and more."""

from collections.abc import Callable

import numpy as np
import pytest

from dvc.config import CODERS, CascadeConfig
from dvc.contracts.test_plane_coders import Bits, PlaneCoderContract, PlaneSource, exchange, noisy
from dvc.slepian_wolf import PlaneCoder, drive
from tests.coders import coder_of

ALL: dict[str, PlaneCoder] = {name: coder_of(name) for name in CODERS} | {
    "cascade few bits": coder_of("cascade", CascadeConfig(0)),
}


class TestCoders(PlaneCoderContract):
    @pytest.fixture(params=ALL.values(), ids=ALL)
    def coder(self, request: pytest.FixtureRequest) -> PlaneCoder:
        coder: PlaneCoder = request.param
        return coder

    def test_hopeless_planes_are_sent_plainly(self, coder: PlaneCoder) -> None:
        bits = np.random.default_rng(1).integers(0, 2, 400, dtype=np.uint8)
        result = exchange(bits, np.zeros(400), coder)
        assert (result.parity_bits, result.crc_bits, result.num_requests) == (400, 0, 1)

    def test_frames_of_planes_of_all_entropies(self, coder: PlaneCoder) -> None:
        """With the check of the frame, all planes are exact, and cost little more than their entropy."""
        rng = np.random.default_rng(6)
        decoder = coder.decoder(1584)
        paid = ideal = 0.0
        for frame in range(2):
            planes = [noisy(rng, 1584, p) for p in (0.15, 0.06, 0.02, 0.01, 0.004, 0.002)]
            source = PlaneSource(np.stack([bits for bits, _ in planes]), coder)
            results = [
                drive(decoder.decode(llr, (frame, n)), source.answer) for n, (_, llr) in enumerate(planes)
            ]
            check = drive(decoder.check(frame), source.answer)
            assert check.success
            for n, (bits, _) in enumerate(planes):
                np.testing.assert_array_equal(check.corrected.get(n, results[n]).bits, bits)
            paid += sum(source.paid.values())
            ideal += sum(result.ideal_bits for result in results)
        assert paid < (1.5 if coder.by_positions else 1.8) * ideal

    @pytest.mark.parametrize(
        "wrong", [lambda n: np.zeros(n + 1, "u1"), np.zeros, lambda n: np.full(n, 2, "u1")]
    )
    def test_wrong_answers_are_refused(self, coder: PlaneCoder, wrong: Callable[[int], Bits]) -> None:
        coroutine = coder.decoder(50).decode(np.full(50, 2.0), (0, 0))
        request = next(coroutine)
        with pytest.raises(ValueError, match=f"expected {request.count} {request.kind} bits"):
            coroutine.send(wrong(request.count))

    @pytest.mark.parametrize("llr_ch", [np.zeros((2, 3)), np.array([np.nan]), np.zeros(0)])
    def test_side_information_must_be_a_vector_of_numbers(
        self, coder: PlaneCoder, llr_ch: np.ndarray
    ) -> None:
        with pytest.raises(ValueError, match="llr_ch"):
            next(coder.decoder(4).decode(llr_ch, (0, 0)))
