"""What a side-information method is given and returns; implement `SideInformationMethod` to add one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dvc.tracks import FeaturePoints, PointTracks
from dvc.video import Frame


@dataclass(frozen=True)
class ReferenceFrame:
    """A decoded frame that predictions may be made from.

    Attributes
    ----------
    index : int
        Display position in the sequence, counted from its first frame.
    frame : Frame
        Decoded samples.
    """

    index: int
    frame: Frame


class Refiner(Protocol):
    """Improves a prediction with what has been decoded of the frame so far."""

    def refine(self, partial: NDArray[np.uint8]) -> "Prediction":
        """Predict again, guided by a partly decoded frame.

        Parameters
        ----------
        partial : ndarray of shape (H, W), uint8
            Luma in which the decoded bands have replaced the prediction's.

        Returns
        -------
        Prediction
            Better prediction of luma; its chroma is None, ask `chroma` for it.
        """

    def chroma(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]] | None:
        """Predict chroma with all that has been learnt.

        Returns
        -------
        tuple of two ndarray of shape (ceil(H / 2), ceil(W / 2)), uint8, or None
            Predicted Cb and Cr; None where the sequence has none.
        """


@dataclass(frozen=True)
class Prediction:
    """Side information of one frame.

    Attributes
    ----------
    luma : ndarray of shape (H, W), float64
        Predicted luma, not rounded.
    chroma : tuple of two ndarray of shape (ceil(H / 2), ceil(W / 2)), uint8, or None
        Predicted chroma; None where the sequence has none.
    compensated : tuple of ndarray of shape (H, W), float64
        The motion-compensated references, whose difference feeds the correlation noise model; at least one.
    method : str
        Name of the method that made it.
    success : bool
        False where the method could not do its work and fell back.
    reason : str
        Why not; empty on success.
    expected_error : ndarray of shape (H, W), float64, or None
        Expected absolute error of each pixel where the method can tell (hidden, border, inconsistent).
    refiner : Refiner or None
        Improves the prediction while the frame is being decoded.
    alternatives : tuple of ndarray of shape (H, W), float64
        Other predictions of the frame, which may turn out better where this one is wrong.
    """

    luma: NDArray[np.float64]
    chroma: tuple[NDArray[np.uint8], NDArray[np.uint8]] | None
    compensated: tuple[NDArray[np.float64], ...]
    method: str
    success: bool = True
    reason: str = ""
    expected_error: NDArray[np.float64] | None = None
    refiner: Refiner | None = None
    alternatives: tuple[NDArray[np.float64], ...] = ()


class SideInformationMethod(Protocol):
    """Predicts frames from decoded ones; one file implements one method."""

    name: str

    def predict(
        self,
        references: Sequence[ReferenceFrame],
        points: PointTracks | FeaturePoints | None,
        instants: Sequence[int],
    ) -> list[Prediction]:
        """Predict the frames at some instants.

        Parameters
        ----------
        references : sequence of ReferenceFrame
            Decoded frames, by increasing index; the first and the last are the key frames of the group.
        points : PointTracks, FeaturePoints or None
            What was received for all frames of the group, whatever the instants: tracks from key frame to
            key frame, or corners of the frames between them; None where the codec sends none.
        instants : sequence of int
            Display positions wanted, between the first and the last reference.

        Returns
        -------
        list of Prediction
            One for each instant; failure is a value, never an exception.
        """
