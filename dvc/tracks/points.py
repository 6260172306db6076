"""Points of one group of pictures: followed from frame to frame, or found in each frame by itself."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointTracks:
    """Points of a key frame, followed through the frames after it up to the next key frame.

    Attributes
    ----------
    positions : ndarray of shape (N, T, 2), float64
        Position (x, y) of each point in pixels at every instant, of which the first and the last are the
        key frames; nan from where the point was lost on (or, before the last, where it is not known).
    """

    positions: Floats

    def __post_init__(self) -> None:
        """Refuse arrays of another shape."""
        if self.positions.ndim != 3 or self.positions.shape[1] < 2 or self.positions.shape[2] != 2:
            raise ValueError(f"`positions` must have shape (N, T >= 2, 2), got {self.positions.shape}")

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.positions)

    @property
    def num_instants(self) -> int:
        """Frames from the first key frame to the last, both included."""
        return int(self.positions.shape[1])

    @classmethod
    def none(cls, num_instants: int) -> "PointTracks":
        """Return no tracks at all.

        Parameters
        ----------
        num_instants : int
            Frames that they would go through.

        Returns
        -------
        PointTracks
            Of length 0.
        """
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
