"""Map of a scene from a whole sequence: pieces, each in one coordinate frame and one scale."""

from collections.abc import Mapping
from dataclasses import dataclass

from dvc.arrays import Bytes, Floats, Singles


@dataclass(frozen=True, eq=False)
class MapPiece:
    """Frames that are located in one Euclidean coordinate frame.

    Attributes
    ----------
    intrinsics : ndarray of shape (3, 3), float64
        Calibration matrix in pixels; the centre of the upper left pixel is (0, 0).
    poses : mapping from int to ndarray of shape (3, 4), float64
        Rotation and translation from the coordinates of the piece to the camera's, by frame index.
    points : ndarray of shape (N, 3), float64
        The dense cloud, in the piece's unit of length.
    colours : ndarray of shape (N, 3), uint8
        Red, green and blue of each point.
    depths : mapping from int to ndarray of shape (H, W), float32
        Distance along the optical axis for some frames; nan if unknown.
    """

    intrinsics: Floats
    poses: Mapping[int, Floats]
    points: Floats
    colours: Bytes
    depths: Mapping[int, Singles]


@dataclass(frozen=True, eq=False)
class SceneMap:
    """The map of a sequence.

    Attributes
    ----------
    width_px, height_px : int
        Size of the frames.
    num_frames : int
        Length of the sequence, including frames that are not located.
    pieces : tuple of MapPiece
        Parts of the sequence that share no coordinate frame, in the order of their frames.
    """

    width_px: int
    height_px: int
    num_frames: int
    pieces: tuple[MapPiece, ...]

    @property
    def num_located(self) -> int:
        """Number of located frames."""
        return sum(len(piece.poses) for piece in self.pieces)

    @property
    def summary(self) -> str:
        """Share of the sequence that is located, in one line."""
        if not self.pieces:
            return f"map: no frame of {self.num_frames} located: few points, or no parallax"
        pieces = f"{len(self.pieces)} piece{'s' * (len(self.pieces) != 1)}"
        return f"map: {pieces}, {self.num_located} of {self.num_frames} frames located"
