"""Motion refinement during decoding: once some bands are known, each block looks again for its origin.

The partly decoded frame is a low-resolution picture of the truth. Matching it against every reference
separately corrects wrong vectors, gives up the assumption of linear motion, and tells which reference sees
the block: each reference is weighted by how well it matches.

References
----------
[Ascenso2005b] J. Ascenso, C. Brites, F. Pereira, "Motion compensated refinement for low complexity pixel
based distributed video coding", AVSS 2005.
[LiSalari1995] W. Li, E. Salari, "Successive elimination algorithm for motion estimation", IEEE Trans. Image
Process. 4(1), 1995.
[Martins2009] R. Martins et al., "Refining side information for improved transform domain Wyner-Ziv video
coding", IEEE Trans. Circuits Syst. Video Technol. 19(9), 2009.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from decoder.side_information import _kernels
from decoder.side_information.block_motion.compensation import (
    MARGIN,
    Offsets,
    compensate,
    compensate_chroma,
    halve,
    phase_planes,
    resize_field,
)
from decoder.side_information.protocol import Prediction
from dvc.video import Frame

BLOCK = 4
"""Side of the refined blocks: that of the transform, whose coefficients become known block by block."""
SMOOTHNESS = 1
"""Cost of a correction, per quarter sample, in units of absolute difference."""

NUM_SUMS = 16
"""Sums that are kept, which take twice the memory of what they are of: those of two frames side by side."""
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
"""Searches of the first, second, ... and all later calls: the more is known, the less there is to search."""


class _Image:
    """Planes to be searched."""

    def __init__(self, planes: NDArray[np.uint8]) -> None:
        self.planes = planes

    @lru_cache(NUM_SUMS)  # noqa: B019 - it is bounded
    def sums(self, side: int) -> NDArray[np.uint16]:
        """Sums over all squares of `side` samples, which tell where there is no need to search."""
        height, width = self.planes.shape[2:]
        sums = np.empty((*self.planes.shape[:2], height - side + 1, width - side + 1), np.uint16)
        for phase in np.ndindex(*self.planes.shape[:2]):
            _kernels.box_sums(self.planes[phase], side, sums[phase])
        return sums


def _padded(plane: NDArray[np.uint8]) -> _Image:
    return _Image(np.pad(plane, MARGIN, mode="edge")[None, None])


class _Reference:
    """A reference at full and at half the resolution."""

    def __init__(self, luma: NDArray[np.uint8]) -> None:
        self.luma = luma
        self.image = _Image(phase_planes(luma))
        self.halved = _Image(phase_planes(halve(luma)))


_in_use: "WeakValueDictionary[int, _Reference]" = WeakValueDictionary()
"""References by the identity of their samples, which they keep: most of the memory that decoding of a frame
takes, and the same for all frames that are decoded side by side."""


def _reference(luma: NDArray[np.uint8]) -> _Reference:
    found = _in_use.get(id(luma))
    if found is None:
        found = _in_use[id(luma)] = _Reference(luma)
    return found


class BlockRefiner:
    """Refines block offsets into several references."""

    def __init__(self, references: Sequence[Frame], offsets: Sequence[Offsets], method: str) -> None:
        self.references = references
        self._searched = [_reference(frame.luma) for frame in references]
        self.offsets = [offset.copy() for offset in offsets]
        self._method = method
        self._weights = [np.ones(offset.shape[:2]) for offset in offsets]
        self._num_calls = 0

    def refine(self, partial: NDArray[np.uint8]) -> Prediction:
        """Search every block anew around its present offsets; see `Refiner.refine`."""
        target, halved_target = _padded(partial), _padded(halve(partial))
        searches = SEARCHES[min(self._num_calls, len(SEARCHES) - 1)]
        self._num_calls += 1
        for number, reference in enumerate(self._searched):
            for search in searches:
                images = (halved_target, reference.halved) if search.halved else (target, reference.image)
                self.offsets[number], costs = _search(*images, self.offsets[number], search)
            difference = costs / float(searches[-1].window ** 2) + 1.0
            self._weights[number] = 1.0 / (difference * np.sqrt(difference))
        planes = [reference.image.planes for reference in self._searched]
        luma, compensated = compensate(planes, self.offsets, self._weights, BLOCK, partial.shape)
        return Prediction(luma, None, tuple(compensated), self._method, refiner=self)

    def chroma(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]] | None:
        """Predict chroma with the offsets found so far; see `Refiner.chroma`."""
        return compensate_chroma(self.references, self.offsets, self._weights, BLOCK)


def _search(
    target: _Image, reference: _Image, offsets: Offsets, search: Search
) -> tuple[Offsets, NDArray[np.int64]]:
    """Return improved offsets of the 4x4 blocks, and the cost of each block that was searched."""
    scale = 2 if search.halved else 1
    factor = scale * search.block // BLOCK
    moved = offsets[::factor, ::factor] // scale
    costs = np.empty(moved.shape[:2], dtype=np.int64)
    _kernels.search_target(
        _kernels.Searched(target.planes, target.sums(search.window // 2)),
        _kernels.Searched(reference.planes, reference.sums(search.window // 2)),
        _kernels.Blocks(MARGIN, search.block, search.window),
        _kernels.Steps(search.radius, search.step, SMOOTHNESS, ENOUGH),
        moved,
        costs,
    )
    return resize_field(moved * scale, offsets.shape[0], offsets.shape[1], factor), costs
