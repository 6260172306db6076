"""A Slepian-Wolf coded plane from end to end: an encoder that answers the requests of `decode_plane`."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf import (
    ParityRequest,
    PlaneResult,
    SlepianWolfSettings,
    TurboDecoder,
    crc,
    decode_plane,
    drive,
    encode_planes,
    family,
)

Bits = NDArray[np.uint8]
SEED = 1


@lru_cache(maxsize=128)
def decoder_of(name: str, index: int, num_bits: int) -> TurboDecoder:
    """Return a decoder that tests share, as planes of a frame do."""
    return TurboDecoder(family(name)[index], num_bits, SEED)


def exchange(bits: Bits, llr_ch: NDArray[np.floating], settings: SlepianWolfSettings) -> PlaneResult:
    """Run `decode_plane` against the true plane, and check that it pays for every bit once and in order."""
    check = crc(bits, settings.crc_bits)
    paid = {"crc": 0, "parity": 0, "uncoded": 0}
    codes = set()

    def answer(request: ParityRequest) -> Bits:
        assert request.start == paid[request.kind]
        paid[request.kind] += request.count
        if request.kind == "parity":
            codes.add(request.code)
            source: Bits = encode_planes(bits[None], family(settings.family)[request.code], SEED)[0]
        else:
            source = check if request.kind == "crc" else bits
        return source[request.start : request.start + request.count]

    coroutine = decode_plane(llr_ch, lambda index: decoder_of(settings.family, index, bits.size), settings)
    result = drive(coroutine, answer)
    assert len(codes) <= 1
    assert (result.crc_bits, result.parity_bits) == (paid["crc"], paid["parity"] + paid["uncoded"])
    return result


def noisy(
    rng: np.random.Generator, num_bits: int, probability: NDArray[np.float64] | float
) -> tuple[Bits, NDArray[np.float64]]:
    """Draw a plane, and side information that differs from it with the given probability, as LLRs."""
    bits = rng.integers(0, 2, num_bits, dtype=np.uint8)
    seen = bits ^ (rng.random(num_bits) < probability)
    confidence = np.log((1 - np.asarray(probability)) / np.asarray(probability))
    return bits, (1 - 2.0 * seen) * confidence
