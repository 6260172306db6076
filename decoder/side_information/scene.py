"""Side information from a reconstruction of the scene: methods `blocks`, `mesh` and `fused`.

The reconstruction of each pair of references is kept while frames between them are predicted. Without tracks
the path of the camera between them is a guess, so three things hedge it: the prediction is averaged along the
guessed motion, it is blended with that of 2D block motion according to where either finds its references
consistent, and 2D block motion serves alone where there is no model that can be trusted.

References
----------
[Maitre2008] Secs. 5.2, 5.3.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from decoder.side_information.blending import scene_share, shared
from decoder.side_information.block_motion import BlockMotionInterpolation, references_around
from decoder.side_information.depth import DepthInterpolator
from decoder.side_information.epipolar_blocks import BlockInterpolator
from decoder.side_information.fused_scene import FusedInterpolator
from decoder.side_information.protocol import Prediction, ReferenceFrame
from decoder.side_information.refinement import BLOCK, BlockRefiner
from decoder.side_information.synthesis import Interpolation, block_offsets, warp_chroma
from dvc.config import CodecConfig
from dvc.multiview.depth_maps import DepthView, Known
from dvc.tracks import FeaturePoints, PointTracks
from dvc.video import Frame
from sfm.model import Model

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]

FUSED = "fused"
"""Name of the method that fuses several predictions."""
PATH_UNCERTAINTY = 0.3
"""How far a fast camera may be off its guessed path, as a share of the motion between the references."""
STEADY_MOTION_PX = 10.0
"""Median motion between the references at which that share is halved: slow cameras are steady."""
LARGEST_SHARE = 0.5
"""Of the scene in the prediction where its camera is a guess."""


class SceneInterpolator(Protocol):
    """Predicts frames between two key frames from a model of the scene."""

    @property
    def views(self) -> tuple[DepthView, DepthView]:
        """Both key frames with their depth."""

    def interpolate(self, camera: Floats, temporal_position: float) -> Interpolation:
        """Predict the view of a camera at a temporal position between the key frames (0 to 1)."""


class Build(Protocol):
    """Builds an interpolator from a model, two frames, and what is known of their depth."""

    def __call__(
        self, model: Model, first: Luma, second: Luma, known: Known = (None, None)
    ) -> SceneInterpolator:
        """Build it."""


INTERPOLATORS: dict[str, Build] = {
    "mesh": DepthInterpolator,
    "blocks": BlockInterpolator,
    FUSED: FusedInterpolator,
}
"""How the motion between the key frames is modelled, by the name of the method."""


class _Scene(NamedTuple):
    """What is known of the scene between two references; no interpolator where nothing can be trusted."""

    before: ReferenceFrame
    after: ReferenceFrame
    model: Model | None
    interpolator: SceneInterpolator | None
    reason: str


class SceneInterpolation:
    """Prediction from a model of the scene between the two references around each instant.

    Parameters
    ----------
    name : str
        Method: a key of `INTERPOLATORS`.
    config : CodecConfig
        Whose estimators to use, seed, and settings of the 2D block motion.
    """

    def __init__(self, name: str, config: CodecConfig) -> None:
        self.name = name
        self._build = INTERPOLATORS[name]
        self._backend, self._seed = config.geometry.backend, config.seed
        self._flat = BlockMotionInterpolation(config.side_information)
        self._scene: _Scene | None = None

    def predict(
        self,
        references: Sequence[ReferenceFrame],
        points: PointTracks | FeaturePoints | None,
        instants: Sequence[int],
    ) -> list[Prediction]:
        """Predict the frames at some instants; see `SideInformationMethod.predict`.

        Parameters
        ----------
        references : sequence of ReferenceFrame
            Decoded frames, by increasing index.
        points : PointTracks, FeaturePoints or None
            Ignored: points are taken to move evenly, (5.8).
        instants : sequence of int
            Display positions wanted.

        Returns
        -------
        list of Prediction
            One for each instant.
        """
        del points
        return [self._predict_one(*references_around(references, instant), instant) for instant in instants]

    def _predict_one(self, before: ReferenceFrame, after: ReferenceFrame, instant: int) -> Prediction:
        from sfm.cameras.camera_path import intermediate_cameras
        from sfm.cameras.tracked_points import linear_points

        flat = self._flat.predict([before, after], None, [instant])[0]
        scene = self._scene_between(before, after)
        if scene.model is None or scene.interpolator is None:
            return _fallen_back(flat, scene.reason)
        late = (instant - before.index) / (after.index - before.index)
        [camera] = intermediate_cameras(scene.model, [linear_points(scene.model, late)])
        if not camera.success:
            return _fallen_back(flat, f"camera: {camera.reason}")
        rendered = scene.interpolator.interpolate(camera.camera, late)
        return self._joined(flat, rendered, late, (before.frame, after.frame))

    def _scene_between(self, before: ReferenceFrame, after: ReferenceFrame) -> _Scene:
        from sfm.pipeline import reconstruct

        known = self._scene
        if known is not None and known.before.frame is before.frame and known.after.frame is after.frame:
            return known
        first, second = before.frame.luma, after.frame.luma
        found = reconstruct(first, second, backend=self._backend, seed=self._seed)
        if found.model is None or not found.success:
            self._scene = _Scene(before, after, None, None, found.reason)
        else:
            interpolator = self._build(found.model, first, second)
            self._scene = _Scene(before, after, found.model, interpolator, "")
        return self._scene

    def _joined(
        self, flat: Prediction, rendered: Interpolation, late: float, frames: tuple[Frame, Frame]
    ) -> Prediction:
        """Blend what the scene predicts with what 2D block motion does."""
        share = scene_share(flat, rendered, bound=LARGEST_SHARE)
        luma = share * hedged(rendered, late) + (1.0 - share) * flat.luma
        chroma = warp_chroma(rendered, [frame.chroma for frame in frames])
        offsets = block_offsets(rendered, BLOCK)
        return Prediction(
            luma,
            chroma,
            shared(share, rendered, flat),
            self.name,
            expected_error=rendered.expected_error,
            refiner=BlockRefiner(frames, offsets, self.name),
            alternatives=(flat.luma, *rendered.hypotheses) if rendered.hypotheses else (),
        )


def _fallen_back(flat: Prediction, reason: str) -> Prediction:
    return replace(flat, success=False, reason=reason)


def hedged(rendered: Interpolation, late: float) -> Floats:
    """Average a prediction along its motion, because the camera's place on its path is a guess.

    Parameters
    ----------
    rendered : Interpolation
        Prediction for the guessed camera.
    late : float
        Instant between the first key frame (0) and the second (1); at the keys nothing is uncertain.

    Returns
    -------
    ndarray of shape (H, W), float64
        Mean of the prediction and of two that are early and late by `PATH_UNCERTAINTY`.
    """
    motion = rendered.positions[1] - rendered.positions[0]
    speed_px = float(np.median(np.hypot(motion[..., 0], motion[..., 1])))
    share = PATH_UNCERTAINTY * speed_px / (speed_px + STEADY_MOTION_PX) * np.sqrt(4.0 * late * (1.0 - late))
    rows, columns = np.indices(rendered.luma.shape)
    total = rendered.luma.copy()
    for step in (-share, share):
        at = (rows + step * motion[..., 1], columns + step * motion[..., 0])
        total += map_coordinates(rendered.luma, at, order=1, mode="nearest")
    mean: Floats = total / 3.0
    return mean
