"""Motion refinement during decoding: once some bands are known, each block looks again for its origin.

The partly decoded frame is a low-resolution picture of the truth. Matching it against every reference
separately corrects wrong vectors, gives up the assumption of linear motion, and tells which reference sees
the block: each reference is weighted by how well it matches.

References
----------
[Ascenso2005b] J. Ascenso, C. Brites, F. Pereira, "Motion compensated refinement for low complexity pixel
based distributed video coding", AVSS 2005.
[Martins2009] R. Martins et al., "Refining side information for improved transform domain Wyner-Ziv video
coding", IEEE Trans. Circuits Syst. Video Technol. 19(9), 2009.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decoder.side_information import _kernels
from decoder.side_information.planes import MARGIN, Offsets, compensate, halve, phase_planes, resize_field
from decoder.side_information.protocol import Prediction
from dvc.video import Frame

BLOCK = 4
"""Side of the refined blocks: that of the transform, whose coefficients become known block by block."""
SMOOTHNESS = 1
"""Cost of a correction, per quarter sample, in units of absolute difference."""


class Search(NamedTuple):
    """One full search around the present offsets."""

    block: int  # side of the blocks that move together, in samples
    window: int  # side of the window that is compared, in samples
    radius: int  # largest correction, in steps
    step: int  # in quarter samples
    halved: bool = False  # at half the resolution, where all of these count half samples


_FINE = (Search(4, 12, 2, 2), Search(4, 12, 1, 1))
SEARCHES = (
    (Search(4, 12, 10, 4, halved=True), *_FINE),
    (Search(4, 8, 6, 4, halved=True), *_FINE),
    (Search(4, 8, 3, 4, halved=True), *_FINE),
    (Search(4, 12, 4, 2), Search(4, 12, 1, 1)),
    (Search(4, 8, 2, 1),),
)
"""Searches of the first, second, ... and all later calls: the more is known, the less there is to search."""


class BlockRefiner:
    """Refines block offsets into several references.

    Parameters
    ----------
    references : sequence of Frame
        Decoded frames.
    offsets : sequence of ndarray of shape (rows, columns, 2), int64
        Per reference, offsets of 4x4 blocks in quarter samples, where the search starts.
    method : str
        Name that refined predictions carry.
    """

    def __init__(self, references: Sequence[Frame], offsets: Sequence[Offsets], method: str) -> None:
        self._references = references
        self._planes = [phase_planes(frame.luma) for frame in references]
        self._halved_planes = [phase_planes(halve(frame.luma)) for frame in references]
        self._offsets = [offset.copy() for offset in offsets]
        self._method = method
        self._weights = [np.ones(offset.shape[:2]) for offset in offsets]
        self._num_calls = 0

    def refine(self, partial: NDArray[np.uint8]) -> Prediction:
        """Search every block anew around its present offsets; see `Refiner.refine`.

        Parameters
        ----------
        partial : ndarray of shape (H, W), uint8
            Partly decoded luma.

        Returns
        -------
        Prediction
            Prediction from the refined offsets.
        """
        target = np.pad(partial, MARGIN, mode="edge")
        halved_target = np.pad(halve(partial), MARGIN, mode="edge")
        searches = SEARCHES[min(self._num_calls, len(SEARCHES) - 1)]
        self._num_calls += 1
        for number, planes in enumerate(self._planes):
            for search in searches:
                images = (halved_target, self._halved_planes[number]) if search.halved else (target, planes)
                self._offsets[number], costs = _search(*images, self._offsets[number], search)
            difference = costs / float(searches[-1].window ** 2) + 1.0
            self._weights[number] = 1.0 / (difference * np.sqrt(difference))
        luma, compensated = compensate(self._planes, self._offsets, self._weights, BLOCK, partial.shape)
        return Prediction(luma, None, tuple(compensated), self._method, refiner=self)

    def chroma(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]] | None:
        """Predict chroma with the offsets found so far; see `Refiner.chroma`.

        Returns
        -------
        tuple of two ndarray of shape (ceil(H / 2), ceil(W / 2)), uint8, or None
            Predicted Cb and Cr; None if a reference has no chroma.
        """
        return compensate_chroma(self._references, self._offsets, self._weights, BLOCK)


def _search(
    target: NDArray[np.uint8], planes: NDArray[np.uint8], offsets: Offsets, search: Search
) -> tuple[Offsets, NDArray[np.int64]]:
    """Return improved offsets of the 4x4 blocks, and the cost of each block that was searched."""
    scale = 2 if search.halved else 1
    factor = scale * search.block // BLOCK
    moved = offsets[::factor, ::factor] // scale
    costs = np.empty(moved.shape[:2], dtype=np.int64)
    _kernels.search_target(
        target,
        planes,
        MARGIN,
        search.block,
        search.window,
        search.radius,
        search.step,
        SMOOTHNESS,
        moved,
        costs,
    )
    return resize_field(moved * scale, offsets.shape[0], offsets.shape[1], factor), costs


def compensate_chroma(
    references: Sequence[Frame],
    offsets: Sequence[Offsets],
    weights: Sequence[NDArray[np.float64]],
    block: int,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]] | None:
    """Predict the chroma planes with the offsets of the luma blocks.

    Parameters
    ----------
    references : sequence of Frame
        Decoded frames.
    offsets : sequence of ndarray of shape (rows, columns, 2), int64
        Per reference, offsets of the luma blocks in luma quarter samples.
    weights : sequence of ndarray of shape (rows, columns), float64
        Per reference, weight of each block.
    block : int
        Side of the luma blocks, even.

    Returns
    -------
    tuple of two ndarray of shape (ceil(H / 2), ceil(W / 2)), uint8, or None
        Predicted Cb and Cr; None if a reference has no chroma.
    """
    chroma = [frame.chroma for frame in references]
    halved = [offset >> 1 for offset in offsets]
    predicted = []
    for component in (0, 1):
        planes = [pair[component] for pair in chroma if pair is not None]
        if len(planes) < len(chroma):
            return None
        samples, _ = compensate(
            [phase_planes(plane) for plane in planes], halved, list(weights), block // 2, planes[0].shape
        )
        predicted.append(np.floor(samples + 0.5).astype(np.uint8))
    return predicted[0], predicted[1]
