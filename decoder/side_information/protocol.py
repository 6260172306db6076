"""Protocols of side-information methods: their inputs and outputs.

Implement `SideInformationMethod` to add one, or `SceneInterpolator` if a model of the scene is all that it
needs: cameras, tracks, references and the blending with block motion are then looked after.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, NamedTuple, Protocol

from dvc.arrays import Bytes, Floats
from dvc.video import Frame

if TYPE_CHECKING:  # frames go from process to process without what makes them
    from dvc.geometry.continuation import DepthMap
    from dvc.geometry.depth_maps import DepthView, Known
    from dvc.tracks import FeaturePoints, PointTracks
    from sfm.scene_model import Model


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


def references_around(
    references: Sequence[ReferenceFrame], instant: int
) -> tuple[ReferenceFrame, ReferenceFrame]:
    """Find the references nearest to an instant on both sides.

    Parameters
    ----------
    references : sequence of ReferenceFrame
        At least one before the instant and one after it.
    instant : int
        Display position.

    Returns
    -------
    before, after : ReferenceFrame
        The nearest ones.
    """
    before = max((r for r in references if r.index < instant), key=lambda r: r.index)
    after = min((r for r in references if r.index > instant), key=lambda r: r.index)
    return before, after


def temporal_position(before: ReferenceFrame, after: ReferenceFrame, instant: int) -> Fraction:
    """Return where an instant lies between two references.

    Parameters
    ----------
    before, after : ReferenceFrame
        The references.
    instant : int
        Display position.

    Returns
    -------
    Fraction
        0 at the first reference, 1 at the second.
    """
    return Fraction(instant - before.index, after.index - before.index)


class Refiner(Protocol):
    """Improves a prediction by the decoded part of the frame."""

    def refine(self, partial: Bytes) -> "Prediction":
        """Predict again, guided by a partly decoded frame.

        Parameters
        ----------
        partial : ndarray of shape (H, W), uint8
            Luma of the prediction with the decoded bands in place.

        Returns
        -------
        Prediction
            Better prediction of luma; its chroma is None, ask `chroma` for it.
        """

    def chroma(self) -> tuple[Bytes, Bytes] | None:
        """Predict Cb and Cr, of half the size, with all that has been learnt; None without chroma."""


@dataclass(frozen=True)
class Prediction:
    """Side information of one frame.

    Attributes
    ----------
    luma : ndarray of shape (H, W), float64
        Predicted luma, not rounded.
    chroma : tuple of two ndarray of shape (ceil(H / 2), ceil(W / 2)), uint8, or None
        Predicted chroma; None if the sequence has no chroma.
    compensated : tuple of ndarray of shape (H, W), float64
        Motion-compensated references, at least one; their difference feeds the correlation noise model.
    method : str
        Name of the method that made it.
    success : bool
        False if the method failed and fell back.
    reason : str
        Why not; empty on success.
    expected_error : ndarray of shape (H, W), float64, or None
        Expected absolute error of each pixel, if the method can estimate it (hidden, border, inconsistent).
    refiner : Refiner or None
        Improves the prediction while the frame is being decoded.
    alternatives : tuple of ndarray of shape (H, W), float64
        Other predictions of the frame, which may turn out better where this one is wrong.
    inverse_depth : ndarray of shape (H, W), float64, or None
        Inverse depth of the frame, if the method has a dense model, in the unit of that model.
    camera : ndarray of shape (3, 4), float64, or None
        Camera of the frame, in the basis of its group's model, if it is known.
    """

    luma: Floats
    chroma: tuple[Bytes, Bytes] | None
    compensated: tuple[Floats, ...]
    method: str
    success: bool = True
    reason: str = ""
    expected_error: Floats | None = None
    refiner: Refiner | None = None
    alternatives: tuple[Floats, ...] = ()
    inverse_depth: Floats | None = None
    camera: Floats | None = None


class SideInformationMethod(Protocol):
    """Predicts frames from decoded ones; one file implements one method."""

    name: str

    def predict(
        self,
        references: Sequence[ReferenceFrame],
        points: "PointTracks | FeaturePoints | None",
        instants: Sequence[int],
    ) -> list[Prediction]:
        """Predict the frames at some instants.

        Parameters
        ----------
        references : sequence of ReferenceFrame
            Decoded frames, by increasing index; the first and the last are the key frames of the group.
        points : PointTracks, FeaturePoints or None
            Received points of all frames of the group, for any instants: tracks from key frame to
            key frame, or corners of the frames between them; None if the codec sends none.
        instants : sequence of int
            Display positions wanted, between the first and the last reference.

        Returns
        -------
        list of Prediction
            One for each instant; failure is a value, never an exception.
        """


class Interpolation(NamedTuple):
    """A frame predicted from a model of the scene.

    Attributes
    ----------
    luma : ndarray of shape (H, W), float64
        Prediction.
    compensated : tuple of ndarray of shape (H, W), float64
        Prediction from each key frame, even if it does not see the point.
    weights : tuple of ndarray of shape (H, W), float64
        Share of each key frame in the prediction; they sum to 1.
    positions : tuple of ndarray of shape (H, W, 2), float64
        Where each pixel lies in each key frame, (x, y) in pixels; may be outside.
    expected_error : ndarray of shape (H, W), float64
        Expected absolute error, in luma levels.
    hypotheses : tuple of ndarray of shape (H, W), float64
        Predictions that it was fused from, if more than one.
    depth : DepthMap or None
        Depth of the frame, if the model has a dense one.
    """

    luma: Floats
    compensated: tuple[Floats, ...]
    weights: tuple[Floats, ...]
    positions: tuple[Floats, ...]
    expected_error: Floats
    hypotheses: tuple[Floats, ...] = ()
    depth: "DepthMap | None" = None


class SceneInterpolator(Protocol):
    """Predicts frames between two key frames from a model of the scene."""

    @property
    def views(self) -> "tuple[DepthView, DepthView]":
        """Both key frames with their depth."""

    def interpolate(self, camera: Floats, temporal_position: float) -> Interpolation:
        """Predict the view of a camera.

        Parameters
        ----------
        camera : ndarray of shape (3, 4), float64
            In normalised coordinates and the basis of the model.
        temporal_position : float
            Of the view between the first key frame (0) and the second (1).

        Returns
        -------
        Interpolation
            The predicted frame.
        """


class SceneInterpolatorType(Protocol):
    """Builder of a `SceneInterpolator`: usually its class."""

    @property
    def name(self) -> str:
        """Name of the method."""

    def __call__(
        self, model: "Model", first: Bytes, second: Bytes, known: "Known" = (None, None)
    ) -> SceneInterpolator:
        """Build it from a model, the luma of its two key frames, and their known depths."""
