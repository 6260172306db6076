"""Prediction from a model of the scene without tracks: the codec 3D-DVC.

The reconstruction of each pair of references is kept while frames between them are predicted. Without tracks
the path of the camera between them is a guess, hedged in three ways: the prediction is averaged along the
guessed motion; it is blended with that of block motion by the consistency of their references; and block
motion replaces it without a reliable model.

References
----------
[Maitre2008] Secs. 5.2, 5.3.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.protocol import (
    Prediction,
    ReferenceFrame,
    SceneInterpolator,
    SceneInterpolatorType,
    references_around,
    temporal_position,
)
from decoder.side_information.synthesis import completed
from decoder.side_information.weighting import blend_guessed
from dvc.arrays import Floats
from dvc.config import CodecConfig
from dvc.geometry.cameras import oriented
from dvc.tracks import FeaturePoints, PointTracks
from sfm.cameras.rebasing import Rebased
from sfm.scene_model import Model


class _Scene(NamedTuple):
    """Model of the scene between two references; no interpolator without a reliable one."""

    before: ReferenceFrame
    after: ReferenceFrame
    model: Model | None
    ordered: Rebased | None
    interpolator: SceneInterpolator | None
    reason: str


class SceneInterpolation:
    """Prediction from a model of the scene between the two references around each instant."""

    def __init__(self, interpolator: SceneInterpolatorType, config: CodecConfig) -> None:
        self.name = interpolator.name
        self._build = interpolator
        self._geometry_config, self._seed = config.geometry, config.seed
        self._block_motion = BlockMotionInterpolation()
        self._scene: _Scene | None = None

    def predict(
        self,
        references: Sequence[ReferenceFrame],
        points: PointTracks | FeaturePoints | None,
        instants: Sequence[int],
    ) -> list[Prediction]:
        """Predict frames; points are taken to move evenly between the key frames, (5.8)."""
        del points
        return [self._predict_one(*references_around(references, instant), instant) for instant in instants]

    def _predict_one(self, before: ReferenceFrame, after: ReferenceFrame, instant: int) -> Prediction:
        from sfm.cameras.camera_path import intermediate_cameras, linear_points

        block_motion = self._block_motion.predict([before, after], None, [instant])[0]
        scene = self._scene_between(before, after)
        if scene.model is None or scene.interpolator is None:
            return replace(block_motion, success=False, reason=scene.reason)
        position = float(temporal_position(before, after, instant))
        [camera] = intermediate_cameras(scene.model, [linear_points(scene.model, position)])
        if not camera.success:
            return replace(block_motion, success=False, reason=f"camera: {camera.reason}")
        wanted: Floats | None = camera.camera
        if scene.ordered is not None:
            wanted = scene.ordered.camera(oriented(camera.camera))
        if wanted is None:
            return replace(block_motion, success=False, reason="a camera lies at infinity")
        rendered = scene.interpolator.interpolate(wanted, position)
        prediction = replace(blend_guessed(block_motion, rendered, position), camera=camera.camera)
        return completed(prediction, rendered, (before.frame, after.frame), self.name)

    def _scene_between(self, before: ReferenceFrame, after: ReferenceFrame) -> _Scene:
        from sfm.cameras.rebasing import rigid_order
        from sfm.pipeline import reconstruct

        known = self._scene
        if known is not None and known.before.frame is before.frame and known.after.frame is after.frame:
            return known
        first, second = before.frame.luma, after.frame.luma
        backend = self._geometry_config.backend
        found = reconstruct(first, second, backend=backend, seed=self._seed)
        if found.model is None or not found.success:
            self._scene = _Scene(before, after, None, None, None, found.reason)
        else:
            ordered = rigid_order(found.model)
            interpolator = self._build(ordered.model if ordered else found.model, first, second)
            self._scene = _Scene(before, after, found.model, ordered, interpolator, "")
        return self._scene
