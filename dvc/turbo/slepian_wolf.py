"""Slepian-Wolf decoding of one bit plane: what to request, when to stop; no I/O."""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dvc.turbo.codes import choose_code, family
from dvc.turbo.crc import POLYNOMIALS, crc
from dvc.turbo.decoder import TurboDecoder
from dvc.turbo.elimination import crc_equations, parity_equations, solve

RequestKind = Literal["crc", "parity", "plain"]


@dataclass(frozen=True)
class SlepianWolfSettings:
    """How the decoder asks for bits and what it believes."""

    family: str = "adaptive"  # codes that encoder and decoder share
    crc_bits: int = 16  # check bits that the encoder computes per plane
    first_crc_bits: int = 8  # of these, how many are requested for every plane
    error_exponent: float = 14.0  # accept a plane when the odds against it are below 2 ** -error_exponent
    max_prior_llr: float = 9.0  # side information is never taken for surer than this
    plain_entropy: float = 0.93  # bits per bit of prior from which parity cannot pay
    initial_rate: float = 0.9  # first parity request, as a share of the prior's entropy
    step: float = 0.01  # further requests, as a share of what was received
    first_iterations: int = 30
    step_iterations: int = 6

    def __post_init__(self) -> None:
        family(self.family)
        if self.crc_bits not in POLYNOMIALS or not 0 < self.first_crc_bits <= self.crc_bits:
            raise ValueError(f"`crc_bits` must be one of {sorted(POLYNOMIALS)} and hold `first_crc_bits`")
        if self.max_prior_llr <= 0 or not 0 < self.step <= 1 or not 0 <= self.initial_rate <= 2:
            raise ValueError("`max_prior_llr`, `step` or `initial_rate` out of range")
        if min(self.first_iterations, self.step_iterations) < 1:
            raise ValueError("iteration counts must be at least 1")


@dataclass(frozen=True)
class PlaneRequest:
    """Bits that the decoder wants: `count` of them from number `start` on, in their order of release."""

    kind: RequestKind
    code: int
    start: int
    count: int


@dataclass(frozen=True)
class PlaneResult:
    """A decoded plane and what it cost; plain bits count as parity."""

    bits: NDArray[np.uint8]
    success: bool
    num_requests: int
    crc_bits: int
    parity_bits: int
    iterations: int


PlaneCoroutine = Generator[PlaneRequest, NDArray[np.uint8], PlaneResult]


class _Plane:
    """State of one plane while it is decoded."""

    def __init__(
        self, llr_ch: NDArray[np.float32], decoder: TurboDecoder, code: int, settings: SlepianWolfSettings
    ) -> None:
        self.llr_ch = llr_ch
        self.decoder = decoder
        self.code = code
        self.settings = settings
        self.num_bits = llr_ch.size
        self.num_requests = 0
        self.iterations = 0
        self.check = np.zeros(0, np.uint8)
        self.parity = np.zeros(0, np.uint8)

    def request(
        self, kind: RequestKind, start: int, count: int
    ) -> Generator[PlaneRequest, NDArray[np.uint8], NDArray[np.uint8]]:
        self.num_requests += 1
        bits = np.asarray((yield PlaneRequest(kind, self.code, start, count)), np.uint8)
        if bits.shape != (count,):
            raise ValueError(f"expected {count} {kind} bits, got shape {bits.shape}")
        return bits

    def request_check(self, count: int) -> Generator[PlaneRequest, NDArray[np.uint8], None]:
        if count > self.check.size:
            new = yield from self.request("crc", self.check.size, count - self.check.size)
            self.check = np.concatenate([self.check, new])

    def request_parity(self, count: int) -> Generator[PlaneRequest, NDArray[np.uint8], None]:
        count = min(count, self.num_bits - self.parity.size)
        if count > 0:
            new = yield from self.request("parity", self.parity.size, count)
            self.parity = np.concatenate([self.parity, new])
            self.decoder.add_parity(new)

    def checks(self, bits: NDArray[np.uint8]) -> bool:
        return bool((crc(bits, self.settings.crc_bits)[: self.check.size] == self.check).all())

    def missing_evidence(self, bits: NDArray[np.uint8]) -> float:
        """Return how many more independent bits must agree before the decisions are accepted."""
        from dvc.turbo import _kernels

        cost = _kernels.prior_information(self.llr_ch, bits)
        odds = cost if cost > 30 else float(np.log2(max(2.0**cost - 1, 1e-9)))
        return self.settings.error_exponent + odds - self.parity.size - self.check.size

    def accept(self, bits: NDArray[np.uint8]) -> Generator[PlaneRequest, NDArray[np.uint8], bool]:
        """Decide whether decisions that satisfy all parity are the plane, asking for check bits where in doubt."""
        if not self.checks(bits):
            return False
        missing = self.missing_evidence(bits)
        if missing > 0:
            if missing > self.settings.crc_bits - self.check.size:
                return False
            yield from self.request_check(self.check.size + int(np.ceil(missing)))
        return self.checks(bits)

    def result(self, bits: NDArray[np.uint8], success: bool) -> PlaneResult:
        return PlaneResult(
            bits.copy(), success, self.num_requests, self.check.size, self.parity.size, self.iterations
        )


def decode_plane(
    llr_ch: NDArray[np.floating],
    decoder_for_code: Callable[[int], TurboDecoder],
    settings: SlepianWolfSettings,
) -> PlaneCoroutine:
    """Decode one bit plane as a coroutine: it yields requests and is sent the bits.

    Parameters
    ----------
    llr_ch : ndarray of shape (N,), float
        Side information as LLR log p(0) / p(1) of every bit.
    decoder_for_code : callable
        Returns the decoder, for planes of N bits, of a code of the family by its index.
    settings : SlepianWolfSettings
        Request policy.

    Yields
    ------
    PlaneRequest
        Wanted bits; the coroutine must be sent a uint8 array of `count` bits.

    Returns
    -------
    PlaneResult
        The plane, exact unless `success` is false.

    Raises
    ------
    ValueError
        If the LLRs are not numbers or the bits sent are not those requested.
    """
    from dvc.turbo import _kernels

    llr = np.asarray(llr_ch, np.float32)
    if llr.ndim != 1 or llr.size < 1 or np.isnan(llr).any():
        raise ValueError(f"`llr_ch` must be a vector of numbers, got shape {llr.shape}")
    llr = np.clip(llr, -settings.max_prior_llr, settings.max_prior_llr)
    entropy_bits = _kernels.prior_entropy(llr)
    if entropy_bits > settings.plain_entropy * llr.size:
        bits = np.asarray((yield PlaneRequest("plain", 0, 0, llr.size)), np.uint8)
        return PlaneResult(bits.copy(), True, 1, 0, llr.size, 0)
    code = choose_code(family(settings.family), entropy_bits / llr.size)
    plane = _Plane(llr, decoder_for_code(code), code, settings)
    plane.decoder.start(llr)
    return (yield from _decode_by_parity(plane, entropy_bits))


def _decode_by_parity(plane: _Plane, entropy_bits: float) -> PlaneCoroutine:
    settings, decoder = plane.settings, plane.decoder
    yield from plane.request_check(min(settings.first_crc_bits, plane.num_bits))
    if (yield from plane.accept(decoder.decisions)):
        return plane.result(decoder.decisions, True)
    wanted, iterations = max(1, int(settings.initial_rate * entropy_bits)), settings.first_iterations
    while plane.parity.size < plane.num_bits:
        yield from plane.request_parity(wanted)
        plane.iterations += decoder.iterate(iterations)
        if decoder.parity_satisfied and (yield from plane.accept(decoder.decisions)):
            return plane.result(decoder.decisions, True)
        wanted, iterations = max(1, round(settings.step * plane.parity.size)), settings.step_iterations
    return (yield from _solve(plane))


def _solve(plane: _Plane) -> PlaneCoroutine:
    """Solve the equations of all N parity bits; check bits settle what they leave open."""
    decoder, settings = plane.decoder, plane.settings
    while True:
        rows = np.concatenate(
            [
                parity_equations(decoder.code, plane.num_bits, decoder.interleaver_seed, plane.parity.size),
                crc_equations(plane.num_bits, settings.crc_bits)[: plane.check.size],
            ]
        )
        solved = solve(rows, np.concatenate([plane.parity, plane.check]), decoder.llr)
        if solved is not None and solved[1] == 0:
            return plane.result(solved[0], True)
        if solved is None or plane.check.size == settings.crc_bits:
            return plane.result(decoder.decisions if solved is None else solved[0], False)
        yield from plane.request_check(min(settings.crc_bits, plane.check.size + solved[1]))
