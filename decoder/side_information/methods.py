"""Methods that `--side-information` and the configuration may name, and predictions from models of scenes.

Without tracks, codec 3D-DVC, the path of the camera between two references is a guess: the prediction is
averaged along the guessed motion and blended with that of block motion by the consistency of their
references. Tracks, codecs 3D-DVC-TE and 3D-DVC-TD, give every frame of a group of pictures its camera, so
that any two decoded frames can serve as references of those between them. The prediction by the scene is
joined with one without it, after alignment by the same tracks. [Maitre2008] Secs. 5.2 to 5.4.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from decoder.side_information.block_motion import BlockMotionInterpolation
from decoder.side_information.mesh import MeshInterpolator
from decoder.side_information.protocol import (
    Interpolation,
    Prediction,
    ReferenceFrame,
    SceneInterpolator,
    SceneInterpolatorType,
    SideInformationMethod,
    references_around,
    temporal_position,
)
from decoder.side_information.scene_interpolators import (
    AveragedDepthInterpolator,
    BlockInterpolator,
    FusedInterpolator,
)
from decoder.side_information.synthesis import blend_guessed, blend_tracked, completed
from decoder.side_information.track_interpolation import (
    METHOD,
    aligned_block_motion,
    corrected,
    interpolate_by_tracks,
)
from decoder.tracking.group_geometry import GroupGeometry, estimate_geometry
from dvc.arrays import Floats
from dvc.config import CodecConfig
from dvc.extensions import SIDE_INFORMATION, Registry, maker
from dvc.geometry.cameras import oriented
from dvc.geometry.depth_maps import DepthMap, KnownDepth
from dvc.tracks import FeaturePoints, PointTracks
from sfm.cameras.rebasing import Rebased
from sfm.scene_model import Correspondences, Model

Around = tuple[ReferenceFrame, ReferenceFrame]
"""The references before and after a frame."""
Points = PointTracks | FeaturePoints


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
        self, references: Sequence[ReferenceFrame], points: Points | None, instants: Sequence[int]
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

        cached = self._scene
        if cached is not None and cached.before.frame is before.frame and cached.after.frame is after.frame:
            return cached
        first, second = before.frame.luma, after.frame.luma
        found = reconstruct(first, second, backend=self._geometry_config.backend, seed=self._seed)
        if found.model is None or not found.success:
            self._scene = _Scene(before, after, None, None, None, found.reason)
        else:
            ordered = rigid_order(found.model)
            interpolator = self._build(ordered.model if ordered else found.model, first, second)
            self._scene = _Scene(before, after, found.model, ordered, interpolator, "")
        return self._scene


SETTLED_DISTANCE = 2
"""Largest distance of references in frames that keep depth from other pairs, which have longer baselines."""


class _Pair(NamedTuple):
    """The scene between two references."""

    before: ReferenceFrame
    after: ReferenceFrame
    rebased: Rebased
    interpolator: SceneInterpolator


class _Group(NamedTuple):
    """Geometry between two frames, and the depths of frames between them."""

    ends: Around
    geometry: GroupGeometry
    # Depth of frames, ranked by how far apart its references are, and minus the first: the greatest counts.
    depths: dict[int, tuple[tuple[int, int], DepthMap]]
    points: dict[int, KnownDepth]


class TrackedSceneInterpolation:
    """Prediction from a model of the scene with cameras from tracked points."""

    def __init__(self, interpolator: SceneInterpolatorType, config: CodecConfig) -> None:
        self.name = interpolator.name
        self._build = interpolator
        self._geometry_config, self._seed = config.geometry, config.seed
        self._settings = config.side_information
        self._untracked = SceneInterpolation(interpolator, config)
        self._remembers = config.gop.references != "keys"
        self._groups: dict[tuple[int, int], _Group] = {}
        self._pair: _Pair | None = None

    def predict(
        self, references: Sequence[ReferenceFrame], points: Points | None, instants: Sequence[int]
    ) -> list[Prediction]:
        """Predict frames from cameras that points give."""
        if points is None:
            return self._untracked.predict(references, None, instants)
        group = self._group((references[0], references[-1]), points)
        if len(group.geometry.tracks) == 0:
            return self._untracked.predict(references, None, instants)
        return [
            self._predict_one(group, references_around(references, instant), instant) for instant in instants
        ]

    def _group(self, ends: Around, points: Points) -> _Group:
        """Return the state of a group of pictures; the last one and its parts are kept."""
        cached = self._groups.get((ends[0].index, ends[1].index))
        if cached is not None and cached.ends[0] is ends[0] and cached.ends[1] is ends[1]:
            return cached
        self._groups.clear()
        self._pair = None
        return self._estimated(ends, points)

    def _estimated(self, ends: Around, points: Points) -> _Group:
        """Reconstruct the scene between two frames."""
        from sfm.pipeline import reconstruct

        keys, settings = (ends[0].frame.luma, ends[1].frame.luma), self._geometry_config
        tracked = None
        if isinstance(points, PointTracks):  # seen in both frames, one point at each pixel of the first
            tracked = Correspondences(points.positions[:, 0], points.positions[:, -1], np.zeros(len(points)))
            tracked = tracked[tracked.finite]
            tracked = tracked[np.unique(np.rint(tracked.first), axis=0, return_index=True)[1]]
        reconstruction = reconstruct(*keys, backend=settings.backend, seed=self._seed, tracked=tracked)
        geometry = estimate_geometry(reconstruction, keys, points, ends[0].index, settings.path_regularity)
        group = self._groups[ends[0].index, ends[1].index] = _Group(ends, geometry, {}, {})
        return group

    def _predict_one(self, group: _Group, around: Around, instant: int) -> Prediction:
        frames = around[0].frame, around[1].frame
        where = group.geometry.positions
        tracks = where(around[0].index), where(instant), where(around[1].index)
        rendered, reason = self._rendered(group, around, instant, tracks)
        warped = None
        if self._settings.fallback == "block-motion":
            unaided = aligned_block_motion(around, instant, tracks)
        else:
            moves = rendered is None or group.geometry.model is None
            warped = interpolate_by_tracks(around, instant, tracks, moves)
            unaided = Prediction(
                warped.luma,
                None,
                warped.compensated,
                METHOD,
                expected_error=warped.expected_error,
                alternatives=warped.hypotheses,
            )
        if rendered is not None:
            blended = replace(blend_tracked(unaided, rendered), camera=group.geometry.camera(instant))
            return completed(blended, rendered, frames, self.name)
        if warped is not None:
            unaided = completed(unaided, warped, frames, unaided.method)
        return replace(unaided, success=False, reason=reason)

    def _rendered(
        self, group: _Group, around: Around, instant: int, tracks: tuple[Floats, Floats, Floats]
    ) -> tuple[Interpolation | None, str]:
        """Return a frame as the scene predicts it; or none, and why not."""
        before, after = around
        geometry = group.geometry
        reason = geometry.missing(before.index, instant, after.index)
        if reason and geometry.parts_may_have_geometry:
            part = before.index, after.index
            if part in self._groups:
                group = self._groups[part]
            else:
                group = self._estimated(around, geometry.part(*part))
            geometry = group.geometry
            reason = geometry.missing(before.index, instant, after.index)
        camera, pair = geometry.camera(instant), None if reason else self._between(group, around)
        camera = None if pair is None or camera is None else pair.rebased.camera(camera)
        if pair is None or camera is None:
            return None, reason or "a camera lies at infinity"
        rendered = pair.interpolator.interpolate(camera, float(temporal_position(before, after, instant)))
        if self._settings.track_corrections:
            rendered = corrected(rendered, (before.frame.luma, after.frame.luma), tracks)
        # Frames that have a neighbour on either side are references of none.
        if self._remembers and after.index - before.index > 2:
            views, rank = pair.interpolator.views, (after.index - before.index, -before.index)
            depths = {before.index: views[0].depth, after.index: views[1].depth, instant: rendered.depth}
            for index, depth in depths.items():
                stored = group.depths.get(index)
                if depth is not None and (stored is None or stored[0] < rank):
                    group.depths[index] = rank, depth
        return rendered, ""

    def _between(self, group: _Group, around: Around) -> _Pair | None:
        before, after = around
        cached = self._pair
        if cached is not None and cached.before is before and cached.after is after:
            return cached
        rebased = group.geometry.between(before.index, after.index)
        if rebased is None:
            return None
        distance = after.index - before.index
        depths = _known_depth(group, before.index, distance), _known_depth(group, after.index, distance)
        interpolator = self._build(rebased.model, before.frame.luma, after.frame.luma, depths)
        self._pair = _Pair(before, after, rebased, interpolator)
        return self._pair


def _known_depth(group: _Group, index: int, distance: int) -> KnownDepth:
    """Return the depth of a reference that longer baselines than that of a pair have given."""
    if index not in group.points:
        group.points[index] = group.geometry.known_depth(index)
    stored = group.depths.get(index)
    depth = stored[1] if stored is not None and stored[0][0] > distance else None
    return group.points[index]._replace(depth=depth, is_settled=distance <= SETTLED_DISTANCE)


Method = Callable[[CodecConfig], SideInformationMethod]
INTERPOLATORS: dict[str, SceneInterpolatorType] = {
    AveragedDepthInterpolator.name: AveragedDepthInterpolator,
    BlockInterpolator.name: BlockInterpolator,
    MeshInterpolator.name: MeshInterpolator,
    FusedInterpolator.name: FusedInterpolator,
}
"""Models of the motion between key frames from a scene, by the name of the method."""


def _scene(method: str, config: CodecConfig) -> SideInformationMethod:
    interpolator = INTERPOLATORS[method]
    if interpolator is FusedInterpolator and config.codec == "2d":
        return BlockMotionInterpolation()  # nothing to fuse it with
    if config.tracks.kind == "none":
        return SceneInterpolation(interpolator, config)
    return TrackedSceneInterpolation(interpolator, config)


METHODS: Registry[Method] = Registry(
    SIDE_INFORMATION,
    {
        BlockMotionInterpolation.name: lambda _: BlockMotionInterpolation(),
        **{name: partial(_scene, name) for name in INTERPOLATORS},
    },
    partial(maker, SIDE_INFORMATION),
)
"""Factories of the methods, from the configuration, by the name in it."""
