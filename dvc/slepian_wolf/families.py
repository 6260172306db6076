"""Families of codes by name: what an encoder computes for each, and who decodes its planes."""

from collections.abc import Callable, Generator
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dvc.slepian_wolf.cascade.frame import CascadeDecoder
from dvc.slepian_wolf.cascade.orders import NUM_ORDERS, prefix_parities
from dvc.slepian_wolf.cascade.reconciliation import CascadeSettings
from dvc.slepian_wolf.coupling import NeighbourCoupling
from dvc.slepian_wolf.requests import Bits, ParityRequest
from dvc.slepian_wolf.results import FrameCheck, PlaneCoroutine, PlaneCost
from dvc.slepian_wolf.turbo.codes import TurboCode, family
from dvc.slepian_wolf.turbo.decoder import TurboDecoder
from dvc.slepian_wolf.turbo.encoder import encode_words
from dvc.slepian_wolf.turbo.plane import SlepianWolfSettings, decode_plane

CASCADE = "cascade"
"""Family without turbo codes: `dvc.slepian_wolf.cascade`."""
Words = NDArray[np.uint64]
ParityEncoder = Callable[[Words, Words], object]
"""Writes the parity of up to 64 planes, bit p of each word that of plane p, to its second argument."""


class PlaneDecoder(Protocol):
    """Decodes the planes of one frame after another."""

    @property
    def cost(self) -> PlaneCost:
        """What planes are expected to cost."""

    def decode(
        self,
        llr_ch: NDArray[np.floating],
        place: tuple[int, int],
        coupling: NeighbourCoupling | None = None,
    ) -> PlaneCoroutine:
        """Decode a plane as a coroutine.

        Parameters
        ----------
        llr_ch : ndarray of shape (N,), float
            Side information as LLR log p(0) / p(1) of every bit.
        place : tuple of two int
            Numbers of the frame, and of the plane in it.
        coupling : NeighbourCoupling, optional
            How bits depend on each other, where they do; a family may leave that aside.
        """

    def check(self, frame: int) -> Generator[ParityRequest, Bits, FrameCheck]:
        """Check the planes of a frame together, and correct those that are wrong, as a coroutine.

        Parameters
        ----------
        frame : int
            Number of the frame.
        """


class TurboPlaneDecoder:
    """Decodes planes with turbo codes, of which each plane is checked by itself."""

    cost = PlaneCost(1.2, 10.0)

    def __init__(self, settings: SlepianWolfSettings, num_bits: int, seed: int) -> None:
        self._settings = settings
        self._num_bits = num_bits
        self._seed = seed
        self._codes = family(settings.family)
        self._decoders: dict[int, TurboDecoder] = {}

    def decode(
        self,
        llr_ch: NDArray[np.floating],
        place: tuple[int, int],
        coupling: NeighbourCoupling | None = None,
    ) -> PlaneCoroutine:
        """Decode a plane as a coroutine: it yields requests and is sent the bits."""
        return decode_plane(llr_ch, self._decoder, self._settings, place)

    def check(self, frame: int) -> Generator[ParityRequest, Bits, FrameCheck]:
        """Do nothing."""
        yield from ()
        return FrameCheck()

    def _decoder(self, code: int) -> TurboDecoder:
        if code not in self._decoders:
            self._decoders[code] = TurboDecoder(self._codes[code], self._num_bits, self._seed)
        return self._decoders[code]


def plane_decoder(settings: SlepianWolfSettings, num_bits: int, seed: int) -> PlaneDecoder:
    """Return a decoder of planes for the family that the settings name."""
    if settings.family != CASCADE:
        return TurboPlaneDecoder(settings, num_bits, seed)
    own = CascadeSettings(
        settings.crc_bits,
        max_prior_llr=settings.max_prior_llr,
        batch=settings.batch,
        batch_bits=settings.batch_bits,
    )
    return CascadeDecoder(own, num_bits, seed)


def num_codes(name: str) -> int:
    """Return how many kinds of parity a family has."""
    return NUM_ORDERS if name == CASCADE else len(family(name))


def parity_encoders(name: str, seed: int) -> tuple[ParityEncoder, ...]:
    """Return what computes the parity of each code of a family."""
    if name == CASCADE:
        return tuple(partial(_encode_order, order, seed) for order in range(NUM_ORDERS))
    return tuple(partial(_encode_turbo, code, seed) for code in family(name))


def _encode_order(order: int, seed: int, words: Words, released: Words) -> None:
    prefix_parities(words, order, seed, released)


def _encode_turbo(code: TurboCode, seed: int, words: Words, released: Words) -> None:
    encode_words(words, code, seed, released)
