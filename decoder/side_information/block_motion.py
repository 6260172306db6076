"""Motion-compensated interpolation with block motion (MCI): the 2D method that every other one has to beat.

Block motion between two low-pass filtered references is searched from coarse to fine over a pyramid: full
forward search at the top, then at each level a choice among the neighbours' vectors and a small search by the
difference of both references along the linear trajectory through the block (bilateral), regularised by the
neighbours and by a vector median. Overlapped compensation of both references gives the prediction.

References
----------
[Ascenso2005] J. Ascenso, C. Brites, F. Pereira, "Improving frame interpolation with spatial motion smoothing
for pixel domain distributed video coding", EURASIP Conf. on Speech, Image Processing and Multimedia, 2005.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from decoder.side_information import _kernels
from decoder.side_information.protocol import Prediction, ReferenceFrame, references_around, temporal_position
from dvc.arrays import Bytes, Floats, Integers
from dvc.tracks import FeaturePoints, PointTracks
from dvc.video import Frame

MARGIN = 40
"""Padding of planes on each side, by replication."""


def phase_planes(plane: Bytes, margin: int = MARGIN) -> Bytes:
    """Interpolate a plane at quarter samples as H.264 does: six taps for half samples, then means of two."""
    padded = np.pad(plane, ((margin + 2, margin + 4), (margin + 2, margin + 4)), mode="edge")
    planes = np.empty((4, 4, plane.shape[0] + 2 * margin, plane.shape[1] + 2 * margin), np.uint8)
    _kernels.quarter_samples(padded, planes)
    return planes


def low_pass(plane: Bytes) -> Bytes:
    """Average over 3x3 samples, as motion search does before it compares noisy or quantised frames."""
    padded = np.pad(plane.astype(np.int32), 1, mode="edge")
    columns = padded[:-2] + padded[1:-1] + padded[2:]
    total = columns[:, :-2] + columns[:, 1:-1] + columns[:, 2:]
    return np.asarray(((total + 4) // 9).astype(np.uint8))


def halve(plane: Bytes) -> Bytes:
    """Average 2x2 samples into one; odd sides are padded by replication."""
    padded = np.pad(plane.astype(np.int32), ((0, plane.shape[0] & 1), (0, plane.shape[1] & 1)), mode="edge")
    total = padded[::2, ::2] + padded[1::2, ::2] + padded[::2, 1::2] + padded[1::2, 1::2]
    return ((total + 2) >> 2).astype(np.uint8)


def compensate(
    references: list[Bytes],
    offsets: list[Integers],
    weights: list[Floats],
    block: int,
    shape: tuple[int, int],
) -> tuple[Floats, list[Floats]]:
    """Predict a plane from displaced overlapping blocks of several references."""
    rows, columns = offsets[0].shape[:2]
    ramp = (np.minimum(np.arange(2 * block) + 0.5, 2 * block - 0.5 - np.arange(2 * block))) / block
    taper = np.outer(ramp, ramp)
    inside = (slice(block // 2, block // 2 + shape[0]), slice(block // 2, block // 2 + shape[1]))
    totals, masses = [], []
    for planes, offset, weight in zip(references, offsets, weights, strict=True):
        total = np.zeros(((rows + 1) * block, (columns + 1) * block))
        mass = np.zeros_like(total)
        _kernels.accumulate_blocks(planes, MARGIN, block, taper, offset, weight, total, mass)
        totals.append(total[inside])
        masses.append(mass[inside])
    compensated = [total / mass for total, mass in zip(totals, masses, strict=True)]
    return sum(totals[1:], totals[0]) / sum(masses[1:], masses[0]), compensated


def compensate_chroma(
    references: Sequence[Frame], offsets: Sequence[Integers], weights: Sequence[Floats], block: int
) -> tuple[Bytes, Bytes] | None:
    """Predict the chroma planes with the offsets of the luma blocks."""
    halved = [offset >> 1 for offset in offsets]

    def _compensated(planes: list[Bytes]) -> Floats:
        phases = [phase_planes(plane) for plane in planes]
        return compensate(phases, halved, list(weights), block // 2, planes[0].shape)[0]

    return predicted_chroma(references, _compensated)


def predicted_chroma(
    references: Sequence[Frame], predict: Callable[[list[Bytes]], Floats]
) -> tuple[Bytes, Bytes] | None:
    """Predict each chroma plane from those of all references; return None unless all have chroma."""
    chroma = [frame.chroma for frame in references if frame.chroma is not None]
    if len(chroma) < len(references):
        return None
    blue, red = (
        np.floor(predict(list(planes)) + 0.5).astype(np.uint8) for planes in zip(*chroma, strict=True)
    )
    return blue, red


def resize_field(field: Integers, rows: int, columns: int, factor: int) -> Integers:
    """Repeat each vector of a field on a finer grid."""
    row = np.minimum(np.arange(rows) // factor, field.shape[0] - 1)
    column = np.minimum(np.arange(columns) // factor, field.shape[1] - 1)
    return np.ascontiguousarray(field[row][:, column])


BLOCK = 4
"""Side of the refined blocks: that of the transform, which reveals coefficients block by block."""
REFINER_SMOOTHNESS = 1
"""Cost of a correction, per quarter sample, in units of absolute difference."""

NUM_SUMS = 16
"""Number of sums that are kept, at twice the memory of their planes: those of two parallel frames."""
ENOUGH = 1.5
"""Mean absolute difference of a block from its origin, in levels, that is not searched any further."""


class Search(NamedTuple):
    """One full search around the present offsets."""

    block: int  # side of the blocks that move together, in samples
    window: int  # side of the window that is compared, in samples
    radius: int  # largest correction, in steps
    step: int  # in quarter samples
    halved: bool = False  # at half the resolution, where all of these count half samples


_FINE = (Search(4, 12, 1, 2), Search(4, 12, 1, 1))
SEARCHES = (
    (Search(4, 12, 10, 4, halved=True), Search(4, 12, 2, 2), Search(4, 12, 1, 1)),
    (Search(4, 8, 6, 4, halved=True), *_FINE),
    (Search(4, 8, 3, 4, halved=True), *_FINE),
    (Search(4, 12, 2, 4), *_FINE),
    (Search(4, 8, 1, 1),),
)
"""Searches of the first, second, ... and all later calls: later ones have less to search."""


@dataclass(eq=False)
class _Image:
    """Planes to be searched."""

    planes: Bytes

    @lru_cache(NUM_SUMS)  # noqa: B019 - it is bounded
    def sums(self, side: int) -> NDArray[np.uint16]:
        """Return sums over all squares of `side` samples, which exclude positions from the search."""
        height, width = self.planes.shape[2:]
        sums = np.empty((*self.planes.shape[:2], height - side + 1, width - side + 1), np.uint16)
        for phase in np.ndindex(*self.planes.shape[:2]):
            _kernels.box_sums(self.planes[phase], side, sums[phase])
        return sums


class _Reference:
    """A reference at full and at half the resolution."""

    def __init__(self, luma: Bytes) -> None:
        self.luma = luma
        self.image = _Image(phase_planes(luma))
        self.halved = _Image(phase_planes(halve(luma)))


_in_use: "WeakValueDictionary[int, _Reference]" = WeakValueDictionary()
"""References by the identity of their samples, which they keep: most of the memory that decoding of a frame
takes, and the same for all frames that are decoded side by side."""


def _reference(luma: Bytes) -> _Reference:
    found = _in_use.get(id(luma))
    if found is None:
        found = _in_use[id(luma)] = _Reference(luma)
    return found


class BlockRefiner:
    """Refines block offsets into several references."""

    def __init__(self, references: Sequence[Frame], offsets: Sequence[Integers], method: str) -> None:
        self.references = references
        self._searched = [_reference(frame.luma) for frame in references]
        self.offsets = [offset.copy() for offset in offsets]
        self._method = method
        self._weights = [np.ones(offset.shape[:2]) for offset in offsets]
        self._num_calls = 0

    def refine(self, partial: Bytes) -> Prediction:
        """Search every block again around its current offsets; see `Refiner.refine`."""
        planes = (np.pad(plane, MARGIN, mode="edge")[None, None] for plane in (partial, halve(partial)))
        target, halved_target = map(_Image, planes)
        searches = SEARCHES[min(self._num_calls, len(SEARCHES) - 1)]
        self._num_calls += 1
        for number, reference in enumerate(self._searched):
            for search in searches:
                images = (halved_target, reference.halved) if search.halved else (target, reference.image)
                self.offsets[number], costs = _search(*images, self.offsets[number], search)
            difference = costs / float(searches[-1].window ** 2) + 1.0
            self._weights[number] = 1.0 / (difference * np.sqrt(difference))
        phases = [reference.image.planes for reference in self._searched]
        luma, compensated = compensate(phases, self.offsets, self._weights, BLOCK, partial.shape)
        return Prediction(luma, None, tuple(compensated), self._method, refiner=self)

    def chroma(self) -> tuple[Bytes, Bytes] | None:
        """Predict chroma with the current offsets; see `Refiner.chroma`."""
        return compensate_chroma(self.references, self.offsets, self._weights, BLOCK)


def _search(
    target: _Image, reference: _Image, offsets: Integers, search: Search
) -> tuple[Integers, Integers]:
    """Return improved offsets of the 4x4 blocks, and the cost of each block that was searched."""
    scale = 2 if search.halved else 1
    factor = scale * search.block // BLOCK
    moved = offsets[::factor, ::factor] // scale
    costs = np.empty(moved.shape[:2], dtype=np.int64)
    _kernels.search_target(
        _kernels.Searched(target.planes, target.sums(search.window // 2)),
        _kernels.Searched(reference.planes, reference.sums(search.window // 2)),
        _kernels.Blocks(MARGIN, search.block, search.window),
        _kernels.Steps(search.radius, search.step, REFINER_SMOOTHNESS, ENOUGH),
        moved,
        costs,
    )
    return resize_field(moved * scale, offsets.shape[0], offsets.shape[1], factor), costs


NUM_COARSE_LEVELS = 2
BLOCK_PX = 8
"""Side of the blocks that move."""
SEARCH_RADIUS_PX = 16
"""Radius of the motion search at the coarsest level."""
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


def estimate_motion(before: Bytes, after: Bytes, position: Fraction) -> Integers:
    """Estimate the block motion between two frames, on the grid of a frame between them."""
    pyramid = [(low_pass(before), low_pass(after))]
    for _ in range(NUM_COARSE_LEVELS):
        pyramid.append((halve(pyramid[-1][0]), halve(pyramid[-1][1])))
    pairs = [(phase_planes(first), phase_planes(second)) for first, second in pyramid]
    shape = pyramid[-1][0].shape
    field = np.zeros((-(-shape[0] // 8), -(-shape[1] // 8), 2), dtype=np.int64)
    steps = _kernels.Steps(min(SEARCH_RADIUS_PX, max(shape) // 4), 4, 0.02)
    _kernels.forward_search(pairs[-1], _kernels.Blocks(MARGIN, 8, 16), steps, np.zeros_like(field), field)
    for level in range(NUM_COARSE_LEVELS, 0, -1):
        steps = _kernels.Steps(2, 4, 4 * SMOOTHNESS)
        field = _bilateral_field(pairs[level], position, field, _kernels.Blocks(MARGIN, 8, 16), steps)
        finer = pyramid[level - 1][0].shape
        side = 8 if level > 1 else 16
        field = resize_field(2 * field, -(-finer[0] // side), -(-finer[1] // side), 2 if level > 1 else 1)
    steps = _kernels.Steps(2, 2, 4 * SMOOTHNESS)
    field = _bilateral_field(pairs[0], position, field, _kernels.Blocks(MARGIN, 16, 24), steps)
    rows, columns = -(-before.shape[0] // BLOCK_PX), -(-before.shape[1] // BLOCK_PX)
    field = resize_field(field, rows, columns, 16 // BLOCK_PX)
    blocks = _kernels.Blocks(MARGIN, BLOCK_PX, BLOCK_PX + 4)
    for step in (2, 1):
        field = _bilateral_field(pairs[0], position, field, blocks, _kernels.Steps(2, step, SMOOTHNESS))
    return vector_median(field)


def split_field(field: Integers, position: Fraction) -> tuple[Integers, Integers]:
    """Split displacements at the missing frame into offsets towards both references."""
    to_before = -((2 * position.numerator * field + position.denominator) // (2 * position.denominator))
    return to_before, to_before + field


def vector_median(field: Integers) -> Integers:
    """Replace each vector by the one of its 3x3 neighbourhood with the least sum of distances."""
    median = np.empty_like(field)
    _kernels.vector_median(field, median)
    return median


def _bilateral_field(
    pair: tuple[Bytes, Bytes],
    position: Fraction,
    field: Integers,
    blocks: _kernels.Blocks,
    steps: _kernels.Steps,
) -> Integers:
    """Bilateral search at one level of the pyramid, around the vectors of a field."""
    instant = position.numerator, position.denominator
    for _ in range(2):
        found, median = np.empty_like(field), vector_median(field)
        _kernels.refine_bilateral(pair, instant, blocks, steps, (field, median), found)
        field = found
    return field
