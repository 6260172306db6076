"""Slepian-Wolf decoding of one bit plane: what to request, when to stop; no I/O."""

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import _kernels
from dvc.slepian_wolf.crc import POLYNOMIALS, crc
from dvc.slepian_wolf.requests import Bits, Kind, ParityRequest, ask
from dvc.slepian_wolf.results import PlaneCoroutine, PlaneResult
from dvc.slepian_wolf.turbo.codes import choose_code, family
from dvc.slepian_wolf.turbo.decoder import TurboDecoder
from dvc.slepian_wolf.turbo.elimination import Solution, ordered_statistics, parity_equations, solve
from dvc.slepian_wolf.turbo.interleaver import num_segments

UNCODED_ALLOWANCE_BITS = 8
"""Planes whose entropy and check come this close to their length, or closer, are sent uncoded."""
SEARCH_COMPETITORS = 1.0
"""Competing codewords to be expected near a plane found by a search."""
NEIGHBOUR_COMPETITORS = 2.0
"""The same for its neighbours."""
SURE_ERRORS = 2.0**-6
"""Expected errors up to which decisions are sure; with more, iterations go on before they are judged."""
POLISH_ITERATIONS = 4
SEARCH_SPACING = 1.02
"""Growth of the parity from one search by ordered statistics to the next."""


@dataclass(frozen=True)
class SlepianWolfSettings:
    """How the decoder asks for bits and what it believes."""

    family: str = "adaptive"  # codes that encoder and decoder share
    crc_bits: int = 16  # check bits that the encoder computes per plane
    first_crc_bits: int = 8  # of these, how many are requested at once; more only where the plane is in doubt
    error_exponent: float = 15.0  # accept a plane when the odds against it are below 2 ** -error_exponent
    max_prior_llr: float = 9.0  # side information is never taken for surer than this
    batch: float = 0.0  # with parities of ranges, what answers are to tell; see `CascadeSettings`
    batch_bits: float = 0.0
    uncoded_entropy: float = 0.93  # bits per bit of prior from which parity cannot pay
    initial_rate: float = 0.75  # first parity request, as a share of the prior's entropy
    step: float = 0.01  # further requests, as a share of the prior's entropy or of what was received
    early_step: float = 0.03  # the same, as long as less than `early_rate` of the entropy was received
    early_rate: float = 0.95
    # The same, where more than `late_rate` of the entropy shows that the prior is wrong.
    late_step: float = 0.04
    late_rate: float = 1.6
    min_step_bits: int = 1  # least further request, where this is no more than `early_step` of the entropy
    # A plane of which more errors than this share of the prior's are left is stuck: then requests are at
    # least `stuck_step` of what was received, and blocks of iterations are `stuck_iterations` long.
    stuck_errors: float = 0.97
    stuck_step: float = 0.01
    stuck_iterations: int = 4
    iterations: int = 4  # after a request; as many again while they cut the expected errors to `progress`
    progress: float = 0.9
    max_iterations: int = 30
    search_work: float = 4e6  # word operations that one search by ordered statistics may cost

    def __post_init__(self) -> None:
        if self.crc_bits not in POLYNOMIALS or not 0 < self.first_crc_bits <= self.crc_bits:
            raise ValueError(f"`crc_bits` must be one of {sorted(POLYNOMIALS)} and hold `first_crc_bits`")
        if self.max_prior_llr <= 0 or not 0 <= self.initial_rate <= 2:
            raise ValueError("`max_prior_llr` must be positive and `initial_rate` within 0..2")
        if not all(0 < step <= 1 for step in (self.step, self.early_step, self.late_step, self.stuck_step)):
            raise ValueError("`step`, `early_step`, `late_step` and `stuck_step` must be within 0..1")
        if not all(1 <= count <= self.max_iterations for count in (self.iterations, self.stuck_iterations)):
            raise ValueError("`iterations` and `stuck_iterations` must be within 1..`max_iterations`")


class _Plane:
    """State of one plane while it is decoded."""

    def __init__(
        self,
        place: tuple[int, int],
        llr_ch: NDArray[np.float32],
        entropy_bits: float,
        code: int,
        settings: SlepianWolfSettings,
    ) -> None:
        self.place = place
        self.llr_ch = llr_ch
        self.entropy_bits = entropy_bits
        self.code = code
        self.settings = settings
        self.num_bits = llr_ch.size
        self.num_requests = 0
        self.iterations = 0
        self.stuck = False
        self.check = np.zeros(0, np.uint8)
        self.parity = np.zeros(0, np.uint8)

    def request(self, kind: Kind, start: int, count: int) -> Generator[ParityRequest, Bits, Bits]:
        self.num_requests += 1
        return (yield from ask(ParityRequest(*self.place, kind, self.code, start, count)))

    def request_check(self, count: int) -> Generator[ParityRequest, Bits, None]:
        """Request check bits until there are `count` of them."""
        new = yield from self.request("crc", self.check.size, count - self.check.size)
        self.check = np.concatenate([self.check, new])

    def request_parity(self, count: int) -> Generator[ParityRequest, Bits, Bits]:
        count = min(count, self.num_bits - self.parity.size)
        new = yield from self.request("parity", self.parity.size, count)
        self.parity = np.concatenate([self.parity, new])
        return new

    def next_count(self) -> int:
        """Return how many parity bits to request next."""
        settings, received = self.settings, self.parity.size
        if received == 0:
            wanted = settings.initial_rate * self.entropy_bits
        elif received < settings.early_rate * self.entropy_bits:
            wanted = settings.early_step * self.entropy_bits
        else:
            step = settings.late_step if received > settings.late_rate * self.entropy_bits else settings.step
            wanted = step * max(received, self.entropy_bits)
        if received and self.stuck:
            wanted = max(wanted, settings.stuck_step * max(received, self.entropy_bits))
        if received:
            wanted = max(
                wanted, min(settings.min_step_bits, math.ceil(settings.early_step * self.entropy_bits))
            )
        return max(1, int(wanted))

    def checks(self, bits: Bits) -> bool:
        return bool((crc(bits, self.settings.crc_bits)[: self.check.size] == self.check).all())

    def missing_evidence(self, bits: Bits, competitors: float) -> float:
        """Return how many more bits must agree before a plane that satisfies all parity is accepted."""
        # Quantised costs and whole exponents: the last digit of a library's logarithm must not decide.
        cost = math.ceil(float(_kernels.prior_information(self.llr_ch, bits)) * 16) / 16
        likelier = cost if cost > 30 else math.log2(max(2.0**cost - 1, 2.0**-60))
        mantissa, exponent = math.frexp(max(competitors, 2.0**-60))
        near = exponent - (mantissa == 0.5)  # the logarithm, rounded up
        return self.settings.error_exponent + max(likelier - self.parity.size, near) - self.check.size

    def accept(self, bits: Bits, competitors: float) -> Generator[ParityRequest, Bits, bool]:
        """Say whether a plane that satisfies all parity is right; ask for check bits where in doubt."""
        if not self.checks(bits):
            return False
        missing = math.ceil(self.missing_evidence(bits, competitors))
        if missing <= 0:
            return True
        if self.check.size + missing > self.settings.crc_bits:
            return False
        yield from self.request_check(self.check.size + missing)
        return self.checks(bits)

    def result(self, bits: Bits, success: bool) -> PlaneResult:
        return PlaneResult(
            bits.copy(),
            success,
            self.num_requests,
            self.check.size,
            self.parity.size,
            self.iterations,
            self.entropy_bits,
            float(_kernels.prior_information(self.llr_ch, bits)),
        )


def decode_plane(
    llr_ch: NDArray[np.floating],
    decoder_for_code: Callable[[int], TurboDecoder],
    settings: SlepianWolfSettings,
    place: tuple[int, int] = (0, 0),
) -> PlaneCoroutine:
    """Decode one bit plane as a coroutine: it yields requests and is sent the bits."""
    llr = np.asarray(llr_ch, np.float32)
    if llr.ndim != 1 or llr.size < 1 or np.isnan(llr).any():
        raise ValueError(f"`llr_ch` must be a vector of numbers, got shape {llr.shape}")
    llr = np.clip(llr, -settings.max_prior_llr, settings.max_prior_llr)
    entropy_bits = float(_kernels.prior_entropy(llr))
    code = choose_code(family(settings.family), entropy_bits / llr.size)
    plane = _Plane(place, llr, entropy_bits, code, settings)
    if entropy_bits + settings.crc_bits > settings.uncoded_entropy * llr.size + UNCODED_ALLOWANCE_BITS:
        plane.code = 0
        plane.parity = yield from plane.request("uncoded", 0, llr.size)
        return plane.result(plane.parity, True)
    yield from plane.request_check(settings.first_crc_bits)
    decisions = (llr < 0).astype(np.uint8)
    if (yield from plane.accept(decisions, 0.0)):
        return plane.result(decisions, True)
    return (yield from _decode_by_parity(plane, decoder_for_code(code)))


def _decode_by_parity(plane: _Plane, decoder: TurboDecoder) -> PlaneCoroutine:
    """Request parity until iterations, or a search, find a plane that can be accepted."""
    decoder.start(plane.llr_ch)
    prior_errors = decoder.expected_errors
    last_search = 0
    while plane.parity.size < plane.num_bits:
        decoder.add_parity((yield from plane.request_parity(plane.next_count())))
        plane.iterations += _iterate(plane, decoder)
        plane.stuck = decoder.expected_errors > plane.settings.stuck_errors * prior_errors
        if decoder.parity_satisfied:
            if decoder.expected_errors > SURE_ERRORS:
                plane.iterations += decoder.polish(POLISH_ITERATIONS)
            if (yield from plane.accept(decoder.decisions, decoder.expected_errors)):
                return plane.result(decoder.decisions, True)
        if _is_worth_a_search(plane, last_search):
            last_search = plane.parity.size
            found = yield from _search(plane, decoder)
            if found is not None:
                return plane.result(found, True)
    return (yield from _solve(plane, decoder))


def _search(plane: _Plane, decoder: TurboDecoder) -> Generator[ParityRequest, Bits, Bits | None]:
    """Look for an acceptable plane that iterations miss; what a search finds is trusted less."""
    equations = parity_equations(decoder.code, plane.num_bits, decoder.interleaver_seed)[: plane.parity.size]
    planes = ordered_statistics(equations, plane.parity, plane.llr_ch, decoder.llr)
    if planes is None:
        return None
    if not decoder.parity_satisfied:  # neighbours help where iterations are stuck in a wrong codeword
        planes = planes[:1]
    for number, bits in enumerate(planes):
        if (yield from plane.accept(bits, NEIGHBOUR_COMPETITORS if number else SEARCH_COMPETITORS)):
            return np.asarray(bits)
    return None


def _iterate(plane: _Plane, decoder: TurboDecoder) -> int:
    """Iterate in blocks as long as that makes the decisions surer; return the iterations done."""
    settings = plane.settings
    block, progress = settings.iterations, settings.progress
    if plane.stuck:
        block, progress = settings.stuck_iterations, settings.stuck_errors
    done = 0
    left = settings.max_iterations
    before = decoder.expected_errors
    while left > 0:
        done += decoder.iterate(min(left, block))
        left -= block
        after = decoder.expected_errors
        if decoder.parity_satisfied or after > progress * before:
            break
        before = after
    return done


def _is_worth_a_search(plane: _Plane, last_search: int) -> bool:
    received = plane.parity.size
    if num_segments(plane.num_bits) > 1 or received < max(plane.entropy_bits, SEARCH_SPACING * last_search):
        return False
    return received**2 * (plane.num_bits / 64) <= plane.settings.search_work


def _solve(plane: _Plane, decoder: TurboDecoder) -> PlaneCoroutine:
    """Solve the equations of all N parity bits; check bits settle what they leave open."""
    segments = num_segments(plane.num_bits)
    bits = np.empty(plane.num_bits, np.uint8)
    open_choices = [np.zeros((0, plane.num_bits), np.uint8)]
    for segment in range(segments):
        part = slice(segment, None, segments)
        parity = plane.parity[part]
        equations = parity_equations(decoder.code, parity.size, decoder.interleaver_seed)
        solution = solve(equations, parity, decoder.llr[part])
        if solution is None:
            return plane.result(decoder.decisions, False)
        bits[part] = solution.bits
        choices = np.zeros((len(solution.free), plane.num_bits), np.uint8)
        choices[:, part] = solution.free
        open_choices.append(choices)
    free = np.concatenate(open_choices)
    while True:
        chosen = _choose(bits, free, plane)
        if chosen is None or plane.check.size == plane.settings.crc_bits:
            return plane.result(
                bits if chosen is None else chosen.bits, chosen is not None and not len(chosen.free)
            )
        if not len(chosen.free):
            return plane.result(chosen.bits, True)
        yield from plane.request_check(min(plane.settings.crc_bits, plane.check.size + len(chosen.free)))


def _choose(bits: Bits, free: Bits, plane: _Plane) -> Solution | None:
    """Use the check bits received to settle free bits; the check is linear."""
    size = plane.check.size
    wanted = crc(bits, plane.settings.crc_bits)[:size] ^ plane.check
    weights = crc(free, plane.settings.crc_bits)[:, :size]  # of the choices in each check bit
    equations = np.zeros((size, (len(free) // 64 + 1) * 64), np.uint8)
    equations[:, : len(free)] = weights.T
    words = np.packbits(equations, axis=1, bitorder="little").view(np.dtype("<u8")).astype(np.uint64)
    solution = solve(words, wanted, np.ones(len(free), np.float32))
    if solution is None:
        return None
    settled = bits ^ (free[solution.bits == 1].sum(axis=0) & 1).astype(np.uint8)
    combinations = (solution.free.astype(np.int64) @ free & 1).astype(np.uint8)
    return Solution(settled, combinations)
