"""What tracks leave to be told of a frame, on some of its blocks: residual, and noise of the references.

References are moved as points have moved. The decoder knows the scene and predicts better, but from pictures
that are coded: of near references the noise of their quantisers is most of the error.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.video.frames import Plane
from dvc.wynerziv import transform
from encoder.one_way import _kernels

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

BLOCK_PX = _kernels.SIDE
SPACING_PX = 16
"""From one sampled block to the next: one in four is looked at."""
_ROUNDING = 1.0 / 3.0
"""Of H.264 encoders in intra pictures: what is less than two thirds of a step from zero becomes zero."""


@dataclass(frozen=True, eq=False)
class BlockErrors:
    """Expected squares of what a frame differs by from its prediction.

    Attributes
    ----------
    residual : ndarray of shape (16, B), float64
        Mean squared coefficients of the residual against references as they were before coding, by bands
        and blocks, in units of the orthonormal transform.
    noise : ndarray of shape (16, B), float64
        What the noise of the references adds.
    """

    residual: Floats
    noise: Floats


@dataclass
class OneWayWork:
    """How much there was to do where no decoder asks.

    Attributes
    ----------
    num_blocks : int
        Sampled blocks of Wyner-Ziv frames.
    num_moved : int
        Those of their references.
    num_intra : int
        Those of key frames.
    num_distances : int
        Pairs of a block and a point whose motion it may follow.
    num_syndrome_sums, num_syndrome_places : int
        Planes times bits of the syndromes that they were added to, and bits of one plane of each block.
    """

    num_blocks: int = 0
    num_moved: int = 0
    num_intra: int = 0
    num_distances: int = 0
    num_syndrome_sums: int = 0
    num_syndrome_places: int = 0


class BlockSampler:
    """Looks at some blocks of frames of one size.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the frames.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.work = OneWayWork()
        height, width = shape
        rows, columns = (np.arange(0, side - BLOCK_PX + 1, SPACING_PX) for side in (height, width))
        self._grid = rows.size, columns.size
        self._corners = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)

    @property
    def num_blocks(self) -> int:
        """Blocks that are looked at; 0 for frames in which none fits."""
        return len(self._corners)

    def intra_noise(self, luma: Plane, step: float) -> Floats:
        """Estimate the noise of a key frame from its quantised intra residual.

        Parameters
        ----------
        luma : ndarray of shape (H, W), uint8
            The key frame before coding.
        step : float
            Step of its quantiser, in coefficient units; 0 if it is lossless.

        Returns
        -------
        ndarray of shape (16, B), float64
            Mean squared error by bands and blocks.
        """
        errors = np.zeros((transform.NUM_BANDS, self.num_blocks))
        if step > 0:
            self.work.num_intra += self.num_blocks
            _kernels.intra_errors(
                luma, self._corners, step, _ROUNDING, transform.SCALE, transform.ORDER, errors
            )
        return errors

    def errors(
        self,
        luma: Plane,
        references: Sequence[Plane],
        noises: Sequence[Floats],
        positions: Sequence[Floats],
    ) -> BlockErrors:
        """Measure the residual of a frame against the mean of its references, moved as points have moved.

        Parameters
        ----------
        luma : ndarray of shape (H, W), uint8
            The frame.
        references : sequence of ndarray of shape (H, W), uint8
            One or more frames before coding.
        noises : sequence of ndarray of shape (16, B), float64
            Noise of each of them.
        positions : sequence of ndarray of shape (N, 2), float64
            Points (x, y) in the frame, then in each reference, in pixels; nan where they are not known.

        Returns
        -------
        BlockErrors
            Of the sampled blocks.
        """
        count = len(references)
        self.work.num_blocks += self.num_blocks
        self.work.num_moved += self.num_blocks * count
        blocks = np.zeros((self.num_blocks, BLOCK_PX, BLOCK_PX), np.int32)
        noise = np.zeros((transform.NUM_BANDS, self.num_blocks))
        for reference, added, motion in zip(references, noises, self._motions(positions), strict=True):
            _kernels.add_half_samples(reference, self._corners, motion, blocks)
            _kernels.add_noise(self._corners, motion, self._grid, SPACING_PX, added, noise)
        _kernels.subtract_samples(luma, self._corners, 4 * count, blocks)
        residual = np.empty_like(noise)
        _kernels.energies(blocks, 4.0 * count, transform.SCALE, transform.ORDER, residual)
        return BlockErrors(residual, noise / count**2)

    def _motions(self, positions: Sequence[Floats]) -> list[Integers]:
        """Return the motion of the blocks into each reference, (x, y) in half pixels."""
        known = np.isfinite(np.hstack(positions)).all(axis=1)
        points, *others = (instant[known] for instant in positions)
        self.work.num_distances += self.num_blocks * len(points)
        distances = np.empty((self.num_blocks, _kernels.NEAREST))
        nearest = np.empty(distances.shape, np.int64)
        _kernels.nearest_points(points, self._corners, distances, nearest)
        motions = []
        for other in others:
            motion = np.empty((self.num_blocks, 2), np.int64)
            _kernels.blend_motion(distances, nearest, other - points, motion)
            motions.append(motion)
        return motions
