"""Turbo codes as a coder of planes: the punctured pair of the thesis, and a check of each plane by itself."""

from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

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

    def __init__(self, num_bits: int, seed: int) -> None:
        self._decoder = TurboDecoder(CLASSICAL, num_bits, seed)

    def decode(
        self,
        llr_ch: NDArray[np.floating],
        position: tuple[int, int],
        coupling: NeighbourCoupling | None = None,
    ) -> PlaneCoroutine:
        """Decode a plane as a coroutine; neighbours are left aside."""
        del coupling
        return decode_plane(llr_ch, self._decoder, position)

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

    def encode(self, code: int, words: Words, parity: Words) -> None:
        """Compute the parity of up to 64 planes."""
        del code
        encode_words(words, CLASSICAL, self._seed, parity)

    def decoder(self, num_bits: int) -> TurboPlaneDecoder:
        """Return a decoder of planes."""
        return TurboPlaneDecoder(num_bits, self._seed)
