"""Methods that `--side-information` and the configuration may name, and predictions from models of scenes.

Without tracks, codec 3D-DVC, the path of the camera between two references is a guess: the prediction is
averaged along the guessed motion and blended with that of block motion by the consistency of their
references. Tracks, codecs 3D-DVC-TE and 3D-DVC-TD, give every frame of a group of pictures its camera, so
that any two decoded frames can serve as references of those between them. The prediction by the scene is
joined with one without it, after alignment by the same tracks. [Maitre2008] Secs. 5.2 to 5.4.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
from dvc.arrays import Bytes, Floats
from dvc.config import CodecConfig
from dvc.extensions import SIDE_INFORMATION, Registry, maker
from dvc.geometry.cameras import oriented
from dvc.geometry.continuation import DepthMap
from dvc.geometry.depth_maps import KnownDepth
from dvc.geometry.triangulation import track_depths
from dvc.tracks import FeaturePoints, PointTracks
from sfm.cameras.rebasing import Rebased, rebase, rigid_order
from sfm.scene_model import Correspondences, Model, Reconstruction

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


MAX_TRACK_RMS_PX = 1.5
"""Largest distance of a track from the projection of its point; tracks beyond are wrong or move."""
MAX_TRACK_SIGMA = 6.0
"""Largest error of a point, relative to that of the tracker, with a reliable depth."""


@dataclass(frozen=True, eq=False)
class GroupGeometry:
    """Scene and cameras of one group of pictures."""

    first_index: int  # display position of the first key frame
    tracks: PointTracks  # tracked points
    model: Model | None  # the scene from the two key frames; None without a reliable one
    # camera of each frame, key frames included, in the basis of the model; None if unknown
    cameras: tuple[Floats | None, ...]
    reason: str  # why the model is missing
    camera_reasons: tuple[str, ...]  # why cameras are missing
    # whether parts may have a scene if the ends have none: not if the camera only turned, or stood still
    parts_may_have_geometry: bool

    def positions(self, index: int) -> Floats:
        """Return the positions of the points in one frame."""
        return self.tracks.positions[:, index - self.first_index]

    def camera(self, index: int) -> Floats | None:
        """Return the camera of one frame."""
        return self.cameras[index - self.first_index]

    def missing(self, *indices: int) -> str:
        """Return why the scene cannot be used with some frames; empty if it can."""
        reasons = (self.camera_reasons[index - self.first_index] for index in indices)
        return self.reason or next((reason for reason in reasons if reason), "")


def estimate_geometry(
    reconstruction: Reconstruction,
    keys: tuple[Bytes, Bytes],
    points: Points,
    first_index: int,
    path_regularity: float = 0.0,
) -> GroupGeometry:
    """Find the cameras of a group of pictures."""
    from decoder.tracking.matching import match_points
    from sfm.cameras.camera_path import regular_cameras, tracked_points

    tracks = points
    if isinstance(tracks, FeaturePoints):
        tracks = match_points(reconstruction, *keys, tracks)
    number, positions = tracks.num_instants, tracks.positions
    if reconstruction.model is None or not reconstruction.success:
        none: tuple[Floats | None, ...] = (None,) * number
        moves, reason = reconstruction.motion not in ("rotation", "none"), reconstruction.reason
        return GroupGeometry(first_index, tracks, None, none, reason, ("",) * number, moves)
    model = reconstruction.model
    ends = positions[:, 0], positions[:, -1]
    instants = [tracked_points(model, *ends, positions[:, k], k / (number - 1)) for k in range(1, number - 1)]
    resections = regular_cameras(model, instants, path_regularity)
    between = [resection.camera if resection.success else None for resection in resections]
    reasons = [f"camera: {resection.reason}" if resection.reason else "" for resection in resections]
    cameras = model.first_camera, *between, model.second_camera
    return in_rigid_order(GroupGeometry(first_index, tracks, model, cameras, "", ("", *reasons, ""), True))


def in_rigid_order(geometry: GroupGeometry) -> GroupGeometry:
    """Order the depths of a group of pictures as a rigid motion sees them."""
    assert geometry.model is not None
    ordered = rigid_order(geometry.model)
    if ordered is None:
        return geometry
    cameras = [None if camera is None else ordered.camera(oriented(camera)) for camera in geometry.cameras]
    return replace(geometry, model=ordered.model, cameras=tuple(cameras))


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
                first, last = (index - geometry.first_index for index in part)
                group = self._estimated(around, PointTracks(geometry.tracks.positions[:, first : last + 1]))
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
        model, cameras = group.geometry.model, [group.geometry.camera(frame.index) for frame in around]
        if model is None or cameras[0] is None or cameras[1] is None:
            return None
        rebased = rebase(model, cameras[0], cameras[1])
        if rebased is None:
            return None
        distance = after.index - before.index
        depths = _known_depth(group, before.index, distance), _known_depth(group, after.index, distance)
        interpolator = self._build(rebased.model, before.frame.luma, after.frame.luma, depths)
        self._pair = _Pair(before, after, rebased, interpolator)
        return self._pair


def _known_depth(group: _Group, index: int, distance: int) -> KnownDepth:
    """Return the depth of a reference by points, and that which longer baselines than a pair's have given."""
    if index not in group.points:
        geometry = group.geometry
        assert geometry.model is not None
        frame, points = geometry.model.pixel_frame, geometry.positions(index)
        found = track_depths(geometry.tracks.positions, geometry.cameras, index - geometry.first_index, frame)
        good = (found.rms_px <= MAX_TRACK_RMS_PX) & (found.sigma_px <= MAX_TRACK_SIGMA)
        size = np.array([frame.width_px, frame.height_px])
        pixels = np.floor(np.nan_to_num(points, nan=-1.0) + 0.5)
        good &= ((pixels >= 0) & (pixels < size)).all(axis=1) & np.isfinite(found.inverse_depth)
        group.points[index] = KnownDepth(None, points[good], found.inverse_depth[good])
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
