"""Planes and frames decoded by parities of ranges: cheap, and corrected where they passed wrongly."""

import numpy as np
import pytest

from dvc.config import CascadeConfig
from dvc.contracts.test_plane_coders import Bits, PlaneSource, exchange, noisy
from dvc.slepian_wolf import CRC_BITS, ParityRequest, PlaneCoder, PlaneResult, crc, drive, joint_check
from tests.coders import coder_of

CASCADE, SINGLE = coder_of("cascade", CascadeConfig(6)), coder_of("cascade", CascadeConfig(0))
AMPLE = coder_of("cascade", CascadeConfig(20))


@pytest.mark.parametrize(("probability", "most"), [(0.005, 1.25), (0.03, 1.13), (0.12, 1.1), (None, 1.1)])
def test_planes_cost_little_more_than_their_entropy(probability: float | None, most: float) -> None:
    """Check bits included; also if side information knows some bits better than others."""
    rng = np.random.default_rng(4 if probability else 5)
    paid = ideal = 0.0
    for _ in range(6):
        bits, llr_ch = noisy(rng, 3000, probability or rng.beta(0.4, 4.0, 3000).clip(1e-3, 0.499))
        result = exchange(bits, llr_ch, CASCADE)
        np.testing.assert_array_equal(result.bits, bits)
        paid += result.parity_bits + result.crc_bits
        ideal += result.ideal_bits
    assert 0.95 * ideal < paid < most * ideal


def test_wrong_planes_are_found_and_corrected() -> None:
    """A plane that passed by itself, but is wrong, fails the check of the frame, and comes out right."""
    rng = np.random.default_rng(8)
    planes = rng.integers(0, 2, (9, 300), dtype=np.uint8)
    llr = (1 - 2.0 * planes) * 4.0
    source = PlaneSource(planes, CASCADE)
    decoder = CASCADE.decoder(300)
    for plane in range(9):
        result = drive(decoder.decode(llr[plane], (0, plane)), source.answer)
        if plane in (2, 7):  # forge what was decoded, as an undetected error would
            wrong = result.bits.copy()
            wrong[[11, 200]] ^= 1
            own = decoder._planes[plane][0]
            forged = PlaneResult(wrong, 1, 0, 0, 0, 0.0, 0.0)
            decoder._planes[plane] = own, forged
    check = drive(decoder.check(), source.answer)
    assert check.success
    assert {2, 7} <= set(check.corrected)
    assert check.crc_bits == source.paid["joint"]
    for plane, result in check.corrected.items():
        np.testing.assert_array_equal(result.bits, planes[plane])
    assert drive(decoder.check(), source.answer).crc_bits == 0  # nothing is left to be checked


def test_runs_of_any_length_are_checked_together() -> None:
    """Runs of a frame differ in their number of bits; a wrong one among them comes out right."""
    rng = np.random.default_rng(9)
    runs = {plane: noisy(rng, num_bits, 0.02) for plane, num_bits in {0: 300, 4: 1, 5: 17, 9: 1024}.items()}
    sources = {plane: PlaneSource(np.tile(bits, (10, 1)), CASCADE) for plane, (bits, _) in runs.items()}

    def answer(request: ParityRequest) -> Bits:
        if request.kind == "joint":
            checks = [crc(runs[plane][0], CRC_BITS) for plane in request.positions]
            return joint_check(np.stack(checks))[: request.count]
        return sources[request.run].answer(request)

    decoder = CASCADE.decoder(300)
    for plane, (bits, llr_ch) in runs.items():
        result = drive(decoder.decode(llr_ch, (0, plane)), answer)
        np.testing.assert_array_equal(result.bits, bits)
    own, result = decoder._planes[5]
    decoder._planes[5] = own, PlaneResult(result.bits ^ 1, 1, 0, 0, 0, 0.0, 0.0)
    check = drive(decoder.check(), answer)
    assert check.success
    assert 5 in check.corrected
    for plane, corrected in check.corrected.items():
        np.testing.assert_array_equal(corrected.bits, runs[plane][0])


def test_the_same_error_in_two_planes_shows() -> None:
    """Check bits of several planes together are no plain sum: equal errors do not cancel out."""
    checks = np.random.default_rng(2).integers(0, 2, (5, 16), dtype=np.uint8)
    changed = checks.copy()
    changed[[1, 3], 4] ^= 1
    assert (joint_check(checks) != joint_check(changed)).any()


@pytest.mark.parametrize(("batched", "fewer"), [(CASCADE, 0.8), (AMPLE, 0.5)], ids=["default", "ample"])
@pytest.mark.parametrize(("probability", "most"), [(0.005, 1.5), (0.03, 1.3), (0.12, 1.2)])
def test_batches_take_fewer_requests_for_some_more_bits(
    probability: float, most: float, batched: PlaneCoder, fewer: float
) -> None:
    rng = np.random.default_rng(4)
    requests, ideal, paid = [0, 0], 0.0, 0
    for _ in range(6):
        bits, llr_ch = noisy(rng, 3000, probability)
        for number, how in enumerate((SINGLE, batched)):
            result = exchange(bits, llr_ch, how)
            np.testing.assert_array_equal(result.bits, bits)
            requests[number] += result.num_requests
        paid += result.parity_bits + result.crc_bits
        ideal += result.ideal_bits
    assert requests[1] < fewer * requests[0]
    assert paid < most * ideal
