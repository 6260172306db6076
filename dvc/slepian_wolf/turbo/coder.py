"""Turbo codes as a coder of planes: the punctured pair of the thesis, and a check of each plane by itself."""

from collections.abc import Generator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dvc.pool import Pool
from dvc.slepian_wolf.coupling import NeighbourCoupling
from dvc.slepian_wolf.protocol import Words
from dvc.slepian_wolf.requests import Bits, ParityRequest
from dvc.slepian_wolf.results import FrameCheck, PlaneCoroutine, PlaneCost
from dvc.slepian_wolf.turbo.codes import CLASSICAL
from dvc.slepian_wolf.turbo.decoder import TurboDecoder
from dvc.slepian_wolf.turbo.encoder import encode_words
from dvc.slepian_wolf.turbo.plane import decode_plane


class TurboPlaneDecoder:
    """Decodes planes with the classical code."""

    cost = PlaneCost(1.2, 10.0)

    def __init__(self, decoders: Pool[TurboDecoder]) -> None:
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
        self._decoders: dict[int, Pool[TurboDecoder]] = {}  # by length of the planes

    def encode(self, code: int, words: Words, parity: Words) -> None:
        """Compute the parity of up to 64 planes."""
        del code
        encode_words(words, CLASSICAL, self._seed, parity)

    def decoder(self, num_bits: int) -> TurboPlaneDecoder:
        """Return a decoder of planes."""
        new = partial(TurboDecoder, CLASSICAL, num_bits, self._seed)
        return TurboPlaneDecoder(self._decoders.setdefault(num_bits, Pool(new)))
