"""Long-term references: earlier key frames that show what the camera comes back to.

Thumbnails tell which key frame looks most like the last frame of a group, and how far it is shifted. Where
the points of the group are found in it again, it shows what the frames right before have not seen.
"""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.config import MAX_LONG_TERM_KEY_BYTES, CodecConfig
from dvc.stream import LongTermReference
from dvc.tracks import decode_tracks, encode_matches
from dvc.video.frames import Plane
from encoder.tracking import PointTracker

Floats = NDArray[np.float64]

MAX_KEPT_PX = 2**25
"""Most pixels of key frames that are kept."""
CELL_PX = 16
"""Side of what a sample of a thumbnail is the mean of."""
REACH_CELLS = 2
"""Shifts of thumbnails that are tried, to every side."""
MAX_DIFFERENCE = 0.5
"""Of thumbnails, relative to the contrast of the wanted one, beyond which points are not looked for."""


class Thumbnail(NamedTuple):
    """A frame in cells."""

    cells: Floats  # mean of each
    contrast: float  # mean absolute deviation from the mean of all

    @classmethod
    def of(cls, luma: Plane) -> "Thumbnail":
        """Average the cells of a frame; what is left over to the right and below has no part."""
        rows, columns = (max(side // CELL_PX, 1) for side in luma.shape)
        tall, wide = luma.shape[0] // rows, luma.shape[1] // columns
        cut = luma[: rows * tall, : columns * wide]
        cells = cut.reshape(rows, tall, columns, wide).mean(axis=(1, 3))
        return cls(cells, float(np.abs(cells - cells.mean()).mean()))

    def shift_to(self, other: "Thumbnail") -> tuple[float, tuple[int, int]]:
        """Find the shift (x, y) in cells at which another one differs least, and by how much."""
        found = []
        for dx, dy in product(range(-REACH_CELLS, REACH_CELLS + 1), repeat=2):
            difference = _overlap(self.cells, -dx, -dy) - _overlap(other.cells, dx, dy)
            if difference.size:
                deviation = float(np.abs(difference - difference.mean()).mean())
                found.append((deviation, dx * dx + dy * dy, dx, dy))
        deviation, _, dx, dy = min(found)
        return deviation, (dx, dy)


def _overlap(cells: Floats, dx: int, dy: int) -> Floats:
    """Return what is left of cells that are shifted out of the picture by (dx, dy)."""
    rows, columns = cells.shape
    return cells[max(dy, 0) : rows + min(dy, 0), max(dx, 0) : columns + min(dx, 0)]


@dataclass(frozen=True)
class _KeyFrame:
    number: int  # of the group that it ends
    luma: Plane
    thumbnail: Thumbnail


@dataclass(frozen=True)
class FoundAgain:
    """Tracks of a group in an earlier key frame."""

    reference: LongTermReference
    share: float  # of the tracks that the frame before the group does not have, those that are found


class LongTermReferences:
    """Keeps the latest key frames, and finds points in them."""

    def __init__(self, config: CodecConfig, tracker: PointTracker) -> None:
        self._config, self._tracker = config, tracker
        video = config.video
        self._most = MAX_KEPT_PX // (video.width * video.height)
        self._kept: list[_KeyFrame] = []

    def add(self, number: int, luma: Plane, num_bytes: int) -> None:
        """Keep the key frame that ends a group."""
        if self._config.gop.long_term_window and num_bytes <= MAX_LONG_TERM_KEY_BYTES:
            self._kept = [*self._kept, _KeyFrame(number, luma, Thumbnail.of(luma))][-self._most :]

    def forget(self, number: int) -> None:
        """Let go of the key frames before a group."""
        self._kept = [key for key in self._kept if key.number >= number]

    def find(self, number: int, last: Plane, num_instants: int, tracks: bytes) -> FoundAgain | None:
        """Find the tracks of a group, as sent, in the key frame that looks most like its last frame."""
        candidate = self._most_alike(number, last)
        if candidate is None:
            return None
        key, shift = candidate
        sent = decode_tracks(tracks, num_instants, self._config)
        ends = sent.positions[:, -1]
        matches = self._tracker.matches(last, ends, key.luma, shift)
        new = np.isfinite(ends[:, 0]) & ~np.isfinite(sent.positions[:, 0, 0])
        if not new.any():
            return None
        reference = LongTermReference(number - key.number, encode_matches(matches, sent, self._config))
        return FoundAgain(reference, float(np.isfinite(matches[new, 0]).mean()))

    def _most_alike(self, number: int, last: Plane) -> tuple[_KeyFrame, tuple[int, int]] | None:
        """Choose the key frame that looks most like a frame, but for a shift, which is told in pixels."""
        oldest = number - self._config.gop.long_term_window
        self._kept = [key for key in self._kept if key.number >= oldest]
        earlier = [key for key in self._kept if key.number < number - 1]
        if not earlier:
            return None
        thumbnail = Thumbnail.of(last)
        looks = [(*thumbnail.shift_to(key.thumbnail), key) for key in earlier]
        difference, (dx, dy), key = min(looks, key=lambda look: look[0])
        if difference > MAX_DIFFERENCE * thumbnail.contrast:
            return None
        return key, (dx * CELL_PX, dy * CELL_PX)
