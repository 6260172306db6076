"""What tracks leave to be sent of a frame, on some of its blocks: residual, and noise of the references.

References are moved as points have moved. The decoder knows the scene and predicts better, but from pictures
that are coded: of near references the noise of their quantisers is most of the error.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from dvc.video.frames import Plane
from dvc.wynerziv import transform
from encoder.rate_control import _kernels

Floats = NDArray[np.float32]
Words = NDArray[np.uint64]

BLOCK_PX = _kernels.SIDE
SPACING_PX = 16
"""Least distance from one sampled block to the next: one in four is looked at."""
_MANY_BLOCKS = 900
"""About as many are enough: of large pictures fewer blocks in a given area are looked at."""
_WEIGHTS = (transform.SCALE / 4.0) ** 2 / (BLOCK_PX // 4) ** 2
"""Of squared coefficients of differences in quarters of grey levels, in means of blocks."""
_ROUNDING = 1.0 / 3.0
"""Of H.264 encoders in intra pictures: what is less than two thirds of a step from zero becomes zero."""


@dataclass(frozen=True, eq=False)
class BlockErrors:
    """Expected squares of what a frame differs by from its prediction."""

    # mean squared coefficients of the residual against references as they were before coding, by bands and
    # blocks, in units of the orthonormal transform
    residual: Floats
    noise: Floats  # what the noise of the references adds


@dataclass
class RateControlWork:
    """How much there was to do to estimate rates."""

    num_blocks: int = 0  # sampled blocks of Wyner-Ziv frames
    num_moved: int = 0  # those of their references
    num_intra: int = 0  # those of key frames
    # pairs of a block and a point whose motion it may follow, as far as they were compared
    num_distances: int = 0
    # planes times bits of the syndromes that they were added to, and bits of one plane of each block
    num_syndrome_sums: int = 0
    num_syndrome_places: int = 0


class BlockSampler:
    """Looks at some blocks of frames of one size."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.work = RateControlWork()
        height, width = shape
        self._spacing_px = max(SPACING_PX, isqrt(height * width // _MANY_BLOCKS) // BLOCK_PX * BLOCK_PX)
        rows, columns = (np.arange(0, side - BLOCK_PX + 1, self._spacing_px) for side in (height, width))
        self._grid = rows.size, columns.size
        self._corners = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
        self._diagonal_px2 = height**2 + width**2
        self.num_blocks = len(self._corners)  # that are looked at; 0 for frames in which none fits

    def intra_noise(self, luma: Plane, step: float) -> Floats:
        """Estimate the noise of a key frame from its quantised intra residual."""
        errors = np.zeros((transform.NUM_BANDS, self.num_blocks), np.float32)
        if step > 0:
            self.work.num_intra += self.num_blocks
            _kernels.intra_errors(
                luma, self._corners, step, _ROUNDING, transform.SCALE, transform.ORDER, errors
            )
        return errors

    def errors(
        self,
        words: Words,
        references: Sequence[Words],
        noises: Sequence[Floats],
        positions: NDArray[np.float64],
    ) -> BlockErrors:
        """Measure the residual of a frame against the mean of its references, moved as points have moved.

        Frames are given by their `overlapping_words`.
        """
        self.work.num_blocks += self.num_blocks
        self.work.num_moved += self.num_blocks * len(references)
        residual, noise = np.empty((2, transform.NUM_BANDS, self.num_blocks), np.float32)
        if self.num_blocks:
            bits = max(len(positions) - 1, 1).bit_length()
            self.work.num_distances += _kernels.block_errors(
                words,
                tuple(references),
                tuple(noises),
                positions,
                _kernels.Sampling(
                    self._grid, self._spacing_px, float(1 << (29 - bits)) / self._diagonal_px2, bits
                ),
                _kernels.Bands(_WEIGHTS, transform.ORDER),
                residual,
                noise,
            )
        return BlockErrors(residual, noise)


def overlapping_words(luma: Plane) -> Words:
    """Return eight samples from each place on as words that overlap; none of pictures that are narrower."""
    height, width = luma.shape
    shape = height, max(width - BLOCK_PX + 1, 0)
    words: Words = np.ndarray(shape, np.uint64, np.ascontiguousarray(luma), strides=(width, 1))
    words.flags.writeable = False
    return words
