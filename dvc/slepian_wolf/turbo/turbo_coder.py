"""Turbo codes as a coder of planes: the punctured pair of the thesis, and a check of each plane by itself."""

import math
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.checks import CRC_BITS, crc
from dvc.slepian_wolf.coupling import NeighbourCoupling, bounded_llr, entropy_bits, ideal_bits
from dvc.slepian_wolf.plane_protocol import FrameCheck, PlaneCoroutine, PlaneCost, PlaneResult, Words
from dvc.slepian_wolf.requests import Bits, Kind, ParityRequest, ask
from dvc.slepian_wolf.turbo.turbo_decoder import TurboDecoder
from dvc.slepian_wolf.turbo.turbo_encoder import CLASSICAL, encode_words

UNCODED_ENTROPY = 0.9
"""Entropy per bit above which a plane is requested uncoded."""
FIRST_CHECK_BITS = 8
"""Number of check bits of the first request, as in [Artigas2007]; more follow if needed."""
ERROR_EXPONENT = 15.0
"""A plane is accepted when the odds against it are below 2 to minus this."""
SURE_ERRORS = 2.0**-6
"""Number of expected errors up to which decisions are sure; with more, iterations continue first."""
POLISH_ITERATIONS = 4

# Sizes of requests and numbers of iterations: a trade of rate for time (`dvc-rd run` with `options.coder`).
FIRST_REQUEST = 0.9
"""First parity, as a share of the entropy."""
STEP, LATE_STEP, LATE = 0.02, 0.04, 1.6
"""Further parity as a share of the received parity or of the entropy; more from `LATE` of the entropy on,
because side information misleads then."""
MIN_STEP_BITS = 3
ITERATIONS, MAX_ITERATIONS, PROGRESS = 4, 30, 0.95
"""Iterations after a request, and again while they cut the expected errors to this share."""
STUCK_ERRORS, STUCK_STEP, STUCK_ITERATIONS = 0.98, 0.03, 2
"""Further parity of a plane that still has this share of its initially expected errors."""


class _Plane:
    """State of one plane while it is decoded."""

    def __init__(self, position: tuple[int, int], llr: NDArray[np.float32]) -> None:
        self.position, self.llr, self.num_bits = position, llr, llr.size
        self.entropy_bits = entropy_bits(llr)
        self.num_requests = self.iterations = self.num_uncoded = 0
        self.stuck = False
        self.check, self.parity = np.zeros(0, np.uint8), np.zeros(0, np.uint8)

    def request(self, kind: Kind, start: int, count: int) -> Generator[ParityRequest, Bits, Bits]:
        self.num_requests += 1
        return (yield from ask(ParityRequest(*self.position, kind, 0, start, count)))

    def request_check(self, count: int) -> Generator[ParityRequest, Bits, None]:
        """Request check bits up to `count`."""
        new = yield from self.request("crc", self.check.size, count - self.check.size)
        self.check = np.concatenate([self.check, new])

    def request_parity(self) -> Generator[ParityRequest, Bits, Bits]:
        count = min(self.next_count(), self.num_bits - self.parity.size)
        new = yield from self.request("parity", self.parity.size, count)
        self.parity = np.concatenate([self.parity, new])
        return new

    def fetch(self) -> PlaneCoroutine:
        """Ask for the bits themselves."""
        bits = yield from self.request("uncoded", 0, self.num_bits)
        self.num_uncoded = self.num_bits
        return self.result(bits)

    def next_count(self) -> int:
        """Return how many parity bits to request next."""
        received, entropy = self.parity.size, self.entropy_bits
        if received == 0:
            return max(1, int(FIRST_REQUEST * entropy))
        step = LATE_STEP if received > LATE * entropy else STUCK_STEP if self.stuck else STEP
        return max(MIN_STEP_BITS, int(step * max(received, entropy)))

    def checks(self, bits: Bits) -> bool:
        return bool((crc(bits, CRC_BITS)[: self.check.size] == self.check).all())

    def missing_evidence(self, bits: Bits, expected_errors: float) -> float:
        """Return how many more bits must agree before a plane that satisfies all parity is accepted."""
        # Quantised costs and whole exponents: the last digit of a library's logarithm must not decide.
        cost = math.ceil(ideal_bits(self.llr, bits) * 16) / 16
        likelier = cost if cost > 30 else math.log2(max(2.0**cost - 1, 2.0**-60))
        mantissa, exponent = math.frexp(max(expected_errors, 2.0**-60))
        near = exponent - (mantissa == 0.5)  # the logarithm, rounded up
        return ERROR_EXPONENT + max(likelier - self.parity.size, near) - self.check.size

    def accept(self, bits: Bits, expected_errors: float) -> Generator[ParityRequest, Bits, bool]:
        """Return whether a plane that satisfies all parity is right; request check bits if that is open."""
        if not self.checks(bits):
            return False
        missing = math.ceil(self.missing_evidence(bits, expected_errors))
        if missing <= 0:
            return True
        if self.check.size + missing > CRC_BITS:
            return False
        yield from self.request_check(self.check.size + missing)
        return self.checks(bits)

    def result(self, bits: Bits) -> PlaneResult:
        return PlaneResult(
            bits.copy(),
            self.num_requests,
            self.check.size,
            self.parity.size + self.num_uncoded,
            self.iterations,
            self.entropy_bits,
            ideal_bits(self.llr, bits),
        )


def decode_plane(
    llr_ch: NDArray[np.floating], decoder: TurboDecoder, position: tuple[int, int] = (0, 0)
) -> PlaneCoroutine:
    """Decode one bit plane as a coroutine: it yields requests and is sent the bits."""
    plane = _Plane(position, bounded_llr(llr_ch))
    if plane.entropy_bits >= UNCODED_ENTROPY * plane.num_bits:
        return (yield from plane.fetch())
    yield from plane.request_check(FIRST_CHECK_BITS)
    decisions = (plane.llr < 0).astype(np.uint8)
    if (yield from plane.accept(decisions, 0.0)):
        return plane.result(decisions)
    return (yield from _decode_by_parity(plane, decoder))


def _decode_by_parity(plane: _Plane, decoder: TurboDecoder) -> PlaneCoroutine:
    """Request parity until iterations find a plane that can be accepted, or all of it has not helped."""
    decoder.start(plane.llr)
    first_errors = decoder.expected_errors
    while plane.parity.size < plane.num_bits:
        decoder.add_parity((yield from plane.request_parity()))
        plane.iterations += _iterate(plane, decoder)
        plane.stuck = decoder.expected_errors > STUCK_ERRORS * first_errors
        if decoder.parity_satisfied:
            if decoder.expected_errors > SURE_ERRORS:
                plane.iterations += decoder.polish(POLISH_ITERATIONS)
            if (yield from plane.accept(decoder.decisions, decoder.expected_errors)):
                return plane.result(decoder.decisions)
    return (yield from plane.fetch())


def _iterate(plane: _Plane, decoder: TurboDecoder) -> int:
    """Iterate in blocks as long as that makes the decisions surer; return the iterations done."""
    block, progress = (STUCK_ITERATIONS, STUCK_ERRORS) if plane.stuck else (ITERATIONS, PROGRESS)
    done, left = 0, MAX_ITERATIONS
    before = decoder.expected_errors
    while left > 0:
        done += decoder.iterate(min(left, block))
        left -= block
        after = decoder.expected_errors
        if decoder.parity_satisfied or after > progress * before:
            break
        before = after
    return done


class DecoderPool:
    """Idle decoders of one plane length; each serves one thread at a time and is kept for the next."""

    def __init__(self, make: Callable[[], TurboDecoder]) -> None:
        self._make = make
        self._idle: list[TurboDecoder] = []

    @contextmanager
    def lent(self) -> Iterator[TurboDecoder]:
        """Lend a decoder."""
        try:
            decoder = self._idle.pop()
        except IndexError:
            decoder = self._make()
        try:
            yield decoder
        finally:
            self._idle.append(decoder)


class TurboPlaneDecoder:
    """Decodes planes with the classical code."""

    cost = PlaneCost(1.2, 10.0)

    def __init__(self, decoders: DecoderPool) -> None:
        self._decoders = decoders

    def decode(
        self,
        llr_ch: NDArray[np.floating],
        position: tuple[int, int],
        coupling: NeighbourCoupling | None = None,
    ) -> PlaneCoroutine:
        """Decode a plane as a coroutine; neighbours are left aside."""
        del coupling
        with self._decoders.lent() as decoder:
            return (yield from decode_plane(llr_ch, decoder, position))

    def check(self, frame: int) -> Generator[ParityRequest, Bits, FrameCheck]:
        """Do nothing."""
        yield from ()
        return FrameCheck()


class TurboCoder:
    """The classical punctured pair."""

    num_codes = 1
    by_positions = False

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._decoders: dict[int, DecoderPool] = {}  # by length of the planes

    def encode(self, code: int, words: Words, parity: Words) -> None:
        """Compute the parity of up to 64 planes."""
        del code
        encode_words(words, CLASSICAL, self._seed, parity)

    def decoder(self, num_bits: int) -> TurboPlaneDecoder:
        """Return a decoder of planes."""
        new = partial(TurboDecoder, CLASSICAL, num_bits, self._seed)
        return TurboPlaneDecoder(self._decoders.setdefault(num_bits, DecoderPool(new)))
