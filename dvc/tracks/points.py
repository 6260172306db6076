"""Points of one group of pictures: followed from frame to frame, or found in each frame by itself."""

from dataclasses import dataclass

import numpy as np

from dvc.arrays import Floats
from dvc.config import CodecConfig


@dataclass(frozen=True, eq=False)
class PointTracks:
    """Points of two key frames, followed through the frames between them.

    Attributes
    ----------
    positions : ndarray of shape (N, T, 2), float64
        Position (x, y) of each point in pixels at every instant, from key frame to key frame; nan if the
        point is lost or unknown.
    num_backward : int
        Number of tracks, the last ones, that were tracked back in time from the last key frame. The rest
        start in the first key frame.
    """

    positions: Floats
    num_backward: int = 0

    def __post_init__(self) -> None:
        """Refuse arrays of another shape."""
        if self.positions.ndim != 3 or self.positions.shape[1] < 2 or self.positions.shape[2] != 2:
            raise ValueError(f"`positions` must have shape (N, T >= 2, 2), got {self.positions.shape}")
        if not 0 <= self.num_backward <= len(self.positions):
            raise ValueError(
                f"`num_backward` must be at most {len(self.positions)} tracks, got {self.num_backward}"
            )

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.positions)

    @property
    def forward(self) -> Floats:
        """Positions of the tracks that start in the first key frame."""
        return self.positions[: len(self) - self.num_backward]

    @property
    def backward(self) -> Floats:
        """Positions of the tracks that were followed back from the last key frame."""
        return self.positions[len(self) - self.num_backward :]

    @property
    def num_instants(self) -> int:
        """Frames from the first key frame to the last, both included."""
        return int(self.positions.shape[1])

    @classmethod
    def none(cls, num_instants: int) -> "PointTracks":
        """Return no tracks, of a number of frames."""
        return cls(np.empty((0, num_instants, 2)))


@dataclass(frozen=True, eq=False)
class FeaturePoints:
    """Corners of the frames between two key frames, each frame by itself.

    Attributes
    ----------
    frames : tuple of ndarray of shape (N, 2), float64
        Points (x, y) of each Wyner-Ziv frame in pixels, column by column of the image.
    """

    frames: tuple[Floats, ...]


def num_positions(config: CodecConfig) -> tuple[int, int]:
    """Return how many positions a point has in x and y."""
    bits = config.tracks.subpixel_bits
    return (config.video.width - 1 << bits) + 1, (config.video.height - 1 << bits) + 1
