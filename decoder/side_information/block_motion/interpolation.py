"""Motion-compensated interpolation with block motion (MCI): the 2D method that every other one has to beat.

Block motion between two low-pass filtered references is searched from coarse to fine over a pyramid: full
forward search at the top, then at each level a choice among the neighbours' vectors and a small search by the
difference of the two references along the linear trajectory through the block (bilateral), 16x16 blocks
first, 8x8 last, each field regularised by its neighbours and by a vector median. Overlapped compensation of
both references, weighted by their distance in time, gives the prediction.

References
----------
[Ascenso2005] J. Ascenso, C. Brites, F. Pereira, "Improving frame interpolation with spatial motion smoothing
for pixel domain distributed video coding", EURASIP Conf. on Speech, Image Processing and Multimedia, 2005.
"""

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from decoder.side_information import _kernels
from decoder.side_information.block_motion.compensation import (
    MARGIN,
    Luma,
    Offsets,
    compensate,
    compensate_chroma,
    halve,
    low_pass,
    phase_planes,
    resize_field,
)
from decoder.side_information.block_motion.refinement import BLOCK, BlockRefiner
from decoder.side_information.protocol import (
    Prediction,
    ReferenceFrame,
    references_around,
    temporal_position,
)
from dvc.tracks import FeaturePoints, PointTracks

NUM_COARSE_LEVELS = 2
BLOCK_PX = 8
"""Side of the blocks that move."""
SEARCH_RADIUS_PX = 16
"""Of the motion search, at the coarsest level."""
SMOOTHNESS = 6
"""Weight of smooth motion against matching blocks."""


class BlockMotionInterpolation:
    """Block-motion interpolation between the two references around each instant."""

    name = "mci"

    def predict(
        self,
        references: Sequence[ReferenceFrame],
        points: PointTracks | FeaturePoints | None,
        instants: Sequence[int],
    ) -> list[Prediction]:
        """Predict frames; points are ignored."""
        del points
        return [self._predict_one(*references_around(references, instant), instant) for instant in instants]

    def _predict_one(self, before: ReferenceFrame, after: ReferenceFrame, instant: int) -> Prediction:
        position = temporal_position(before, after, instant)
        field = estimate_motion(before.frame.luma, after.frame.luma, position)
        offsets = list(split_field(field, position))
        shape = before.frame.luma.shape
        weights = [np.full(field.shape[:2], weight) for weight in (1.0 - float(position), float(position))]
        frames = [before.frame, after.frame]
        planes = [phase_planes(frame.luma) for frame in frames]
        luma, compensated = compensate(planes, offsets, weights, BLOCK_PX, shape)
        chroma = compensate_chroma(frames, offsets, weights, BLOCK_PX)
        rows, columns = -(-shape[0] // BLOCK), -(-shape[1] // BLOCK)
        fine = [resize_field(offset, rows, columns, BLOCK_PX // BLOCK) for offset in offsets]
        return Prediction(
            luma, chroma, tuple(compensated), self.name, refiner=BlockRefiner(frames, fine, self.name)
        )


def estimate_motion(before: Luma, after: Luma, position: Fraction) -> Offsets:
    """Estimate the block motion between two frames, on the grid of a frame between them."""
    pyramid = [(low_pass(before), low_pass(after))]
    for _ in range(NUM_COARSE_LEVELS):
        pyramid.append((halve(pyramid[-1][0]), halve(pyramid[-1][1])))
    planes = [(phase_planes(first), phase_planes(second)) for first, second in pyramid]
    search = _LevelSearch(position)
    field = _forward_field(*planes[-1], pyramid[-1][0].shape, SEARCH_RADIUS_PX)
    for level in range(NUM_COARSE_LEVELS, 0, -1):
        field = search.run(*planes[level], field, block=8, window=16, step=4, smoothness=4 * SMOOTHNESS)
        finer = pyramid[level - 1][0].shape
        side = 8 if level > 1 else 16
        field = resize_field(2 * field, -(-finer[0] // side), -(-finer[1] // side), 2 if level > 1 else 1)
    field = search.run(*planes[0], field, block=16, window=24, step=2, smoothness=4 * SMOOTHNESS)
    rows, columns = -(-before.shape[0] // BLOCK_PX), -(-before.shape[1] // BLOCK_PX)
    field = resize_field(field, rows, columns, 16 // BLOCK_PX)
    for step in (2, 1):
        field = search.run(*planes[0], field, BLOCK_PX, window=BLOCK_PX + 4, step=step, smoothness=SMOOTHNESS)
    return vector_median(field)


def split_field(field: Offsets, position: Fraction) -> tuple[Offsets, Offsets]:
    """Split displacements at the missing frame into offsets towards both references."""
    to_before = _kernels.split_vector(field, position.numerator, position.denominator)
    return to_before, to_before + field


def vector_median(field: Offsets) -> Offsets:
    """Replace each vector by that of its 3x3 neighbourhood of the least sum of distances to the others."""
    median = np.empty_like(field)
    _kernels.vector_median(field, median)
    return median


def _forward_field(before: Luma, after: Luma, shape: tuple[int, ...], radius: int) -> Offsets:
    """Full search at the coarsest level of the pyramid, between phase planes of frames of a shape."""
    rows, columns = -(-shape[0] // 8), -(-shape[1] // 8)
    field = np.zeros((rows, columns, 2), dtype=np.int64)
    starts = np.zeros_like(field)
    radius = min(radius, max(shape) // 4)
    blocks, steps = _kernels.Blocks(MARGIN, 8, 16), _kernels.Steps(radius, 4, 0.02)
    _kernels.forward_search(_kernels.Pair(before, after), blocks, steps, starts, field)
    return field


class _LevelSearch:
    """Bilateral search between the phase planes of one pyramid level, around the vectors of a field."""

    def __init__(self, position: Fraction) -> None:
        self._position = (position.numerator, position.denominator)

    def run(
        self, before: Luma, after: Luma, field: Offsets, block: int, window: int, step: int, smoothness: int
    ) -> Offsets:
        blocks, steps = _kernels.Blocks(MARGIN, block, window), _kernels.Steps(2, step, smoothness)
        pair = _kernels.Pair(before, after)
        for _ in range(2):
            found, median = np.empty_like(field), vector_median(field)
            _kernels.refine_bilateral(pair, self._position, blocks, steps, (field, median), found)
            field = found
        return field
