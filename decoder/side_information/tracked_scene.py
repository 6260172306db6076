"""Side information from a model of the scene and tracked points: the thesis's 3D-DVC-TE and 3D-DVC-TD.

Tracks give every frame of a group of pictures its camera, so that any two decoded frames can serve as
references of those between them. The prediction by the scene is joined with that of block motion after
alignment by the same tracks, by the consistency of their references.

References
----------
[Maitre2008] Sec. 5.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from decoder.side_information.alignment import AlignedBlockMotion
from decoder.side_information.protocol import (
    Interpolation,
    Prediction,
    ReferenceFrame,
    SceneInterpolator,
    SceneInterpolatorType,
    references_around,
    temporal_position,
)
from decoder.side_information.synthesis import completed, corrected
from decoder.side_information.track_interpolation import METHOD, interpolate_by_tracks
from decoder.side_information.untracked_scene import SceneInterpolation
from decoder.side_information.weighting import blend_tracked
from dvc.arrays import Bytes, Floats
from dvc.config import CodecConfig
from dvc.geometry.cameras import oriented
from dvc.geometry.continuation import DepthMap
from dvc.geometry.depth_maps import KnownDepth
from dvc.geometry.triangulation import track_depths
from dvc.tracks import FeaturePoints, PointTracks
from sfm.cameras.rebasing import Rebased, rebase
from sfm.scene_model import Correspondences, Model, Reconstruction

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
    # whether parts of the group may have a scene if its ends have none: not if
    # the camera only turned, or stood still
    parts_may_have_geometry: bool

    def positions(self, index: int) -> Floats:
        """Return the positions of the points in one frame."""
        positions: Floats = self.tracks.positions[:, index - self.first_index]
        return positions

    def camera(self, index: int) -> Floats | None:
        """Return the camera of one frame."""
        return self.cameras[index - self.first_index]

    def part(self, first: int, last: int) -> PointTracks:
        """Return the tracks between two frames."""
        return PointTracks(self.tracks.positions[:, first - self.first_index : last + 1 - self.first_index])

    def missing(self, *indices: int) -> str:
        """Return why the scene cannot be used with some frames; empty if it can."""
        reasons = (self.camera_reasons[index - self.first_index] for index in indices)
        return self.reason or next((reason for reason in reasons if reason), "")

    def between(self, first: int, second: int) -> Rebased | None:
        """Describe the scene by two frames of the group."""
        cameras = self.camera(first), self.camera(second)
        if self.model is None or cameras[0] is None or cameras[1] is None:
            return None
        return rebase(self.model, cameras[0], cameras[1])

    def known_depth(self, index: int) -> KnownDepth:
        """Return the depth of the points that one frame sees, from all frames that see them."""
        assert self.model is not None
        frame, view = self.model.pixel_frame, index - self.first_index
        found = track_depths(self.tracks.positions, self.cameras, view, frame)
        points = self.tracks.positions[:, view]
        good = (found.rms_px <= MAX_TRACK_RMS_PX) & (found.sigma_px <= MAX_TRACK_SIGMA)
        size = np.array([frame.width_px, frame.height_px])
        places = np.floor(np.nan_to_num(points, nan=-1.0) + 0.5)
        good &= ((places >= 0) & (places < size)).all(axis=1) & np.isfinite(found.inverse_depth)
        return KnownDepth(None, points[good], found.inverse_depth[good])


def estimate_geometry(
    reconstruction: Reconstruction,
    keys: tuple[Bytes, Bytes],
    points: PointTracks | FeaturePoints,
    first_index: int,
    path_regularity: float = 0.0,
) -> GroupGeometry:
    """Find the cameras of a group of pictures."""
    from decoder.tracking import match_points
    from sfm.cameras.camera_path import regular_cameras, tracked_points

    tracks = points
    if isinstance(tracks, FeaturePoints):
        tracks = match_points(reconstruction, *keys, tracks)
    number, positions = tracks.num_instants, tracks.positions
    if reconstruction.model is None or not reconstruction.success:
        none: tuple[Floats | None, ...] = (None,) * number
        parts_may_have_geometry = reconstruction.motion not in ("rotation", "none")
        return GroupGeometry(
            first_index, tracks, None, none, reconstruction.reason, ("",) * number, parts_may_have_geometry
        )
    model = reconstruction.model
    ends = positions[:, 0], positions[:, -1]
    instants = [tracked_points(model, *ends, positions[:, k], k / (number - 1)) for k in range(1, number - 1)]
    found = regular_cameras(model, instants, path_regularity)
    cameras = [resection.camera if resection.success else None for resection in found]
    reasons = [f"camera: {resection.reason}" if resection.reason else "" for resection in found]
    geometry = GroupGeometry(
        first_index,
        tracks,
        model,
        (model.first_camera, *cameras, model.second_camera),
        "",
        ("", *reasons, ""),
        True,
    )
    return in_rigid_order(geometry)


def in_rigid_order(geometry: GroupGeometry) -> GroupGeometry:
    """Order the depths of a group of pictures as a rigid motion sees them."""
    from sfm.cameras.rebasing import rigid_order

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


class _FoundDepth(NamedTuple):
    """Depth of a frame, and the references that gave it."""

    rank: tuple[int, int]  # how far apart they are, and minus the first: the greatest counts, in any order
    depth: DepthMap


class _Group(NamedTuple):
    """Geometry between two frames, and the depths of frames between them found so far."""

    ends: tuple[ReferenceFrame, ReferenceFrame]
    geometry: GroupGeometry
    depths: dict[int, _FoundDepth]
    points: dict[int, KnownDepth]


class TrackedSceneInterpolation:
    """Prediction from a model of the scene with cameras from tracked points."""

    def __init__(self, interpolator: SceneInterpolatorType, config: CodecConfig) -> None:
        self.name = interpolator.name
        self._build = interpolator
        self._geometry_config, self._seed = config.geometry, config.seed
        self._settings = config.side_information
        self._aligned = AlignedBlockMotion()
        self._untracked = SceneInterpolation(interpolator, config)
        self._corrects = config.side_information.track_corrections
        self._remembers = config.gop.references != "keys"
        self._groups: dict[tuple[int, int], _Group] = {}
        self._pair: _Pair | None = None

    def predict(
        self,
        references: Sequence[ReferenceFrame],
        points: PointTracks | FeaturePoints | None,
        instants: Sequence[int],
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

    def _group(
        self, ends: tuple[ReferenceFrame, ReferenceFrame], points: PointTracks | FeaturePoints
    ) -> _Group:
        """Return the state of a group of pictures; the last one and its parts are kept."""
        known = self._groups.get((ends[0].index, ends[1].index))
        if known is not None and known.ends[0] is ends[0] and known.ends[1] is ends[1]:
            return known
        self._groups.clear()
        self._pair = None
        return self._estimated(ends, points)

    def _estimated(
        self, ends: tuple[ReferenceFrame, ReferenceFrame], points: PointTracks | FeaturePoints
    ) -> _Group:
        group = _Group(ends, self._geometry(ends, points), {}, {})
        self._groups[ends[0].index, ends[1].index] = group
        return group

    def _geometry(
        self,
        ends: tuple[ReferenceFrame, ReferenceFrame],
        points: PointTracks | FeaturePoints,
    ) -> GroupGeometry:
        """Reconstruct the scene between two frames."""
        from sfm.pipeline import reconstruct

        keys = ends[0].frame.luma, ends[1].frame.luma
        how = self._geometry_config
        tracked = _end_to_end(points) if isinstance(points, PointTracks) else None
        reconstruction = reconstruct(*keys, backend=how.backend, seed=self._seed, tracked=tracked)
        return estimate_geometry(reconstruction, keys, points, ends[0].index, how.path_regularity)

    def _part(self, group: _Group, around: tuple[ReferenceFrame, ReferenceFrame]) -> _Group:
        """Return a part of a group that has no geometry as a whole."""
        place = around[0].index, around[1].index
        if place in self._groups:
            return self._groups[place]
        return self._estimated(around, group.geometry.part(*place))

    def _predict_one(
        self, group: _Group, around: tuple[ReferenceFrame, ReferenceFrame], instant: int
    ) -> Prediction:
        frames = around[0].frame, around[1].frame
        where = group.geometry.positions
        tracks = where(around[0].index), where(instant), where(around[1].index)
        rendered, reason = self._rendered(group, around, instant, tracks)
        unaided, warped = self._without_scene(
            around, instant, tracks, rendered is None or group.geometry.model is None
        )
        if rendered is not None:
            blended = replace(blend_tracked(unaided, rendered), camera=group.geometry.camera(instant))
            return completed(blended, rendered, frames, self.name)
        if warped is not None:
            unaided = completed(unaided, warped, frames, unaided.method)
        return replace(unaided, success=False, reason=reason)

    def _without_scene(
        self,
        around: tuple[ReferenceFrame, ReferenceFrame],
        instant: int,
        tracks: tuple[Floats, Floats, Floats],
        moves: bool,
    ) -> tuple[Prediction, Interpolation | None]:
        """Predict a frame from tracks only; return also the warped references, if it is to be completed."""
        if self._settings.fallback == "block-motion":
            return self._aligned.predict(around, instant, tracks), None
        warped = interpolate_by_tracks(around, instant, tracks, moves)
        prediction = Prediction(
            warped.luma,
            None,
            warped.compensated,
            METHOD,
            expected_error=warped.expected_error,
            alternatives=warped.hypotheses,
        )
        return prediction, warped

    def _rendered(
        self,
        group: _Group,
        around: tuple[ReferenceFrame, ReferenceFrame],
        instant: int,
        tracks: tuple[Floats, Floats, Floats],
    ) -> tuple[Interpolation | None, str]:
        """Return a frame as the scene predicts it; or none, and why not."""
        before, after = around
        geometry = group.geometry
        reason = geometry.missing(before.index, instant, after.index)
        if reason and geometry.parts_may_have_geometry:
            group = self._part(group, around)
            geometry = group.geometry
            reason = geometry.missing(before.index, instant, after.index)
        camera, pair = geometry.camera(instant), None if reason else self._between(group, around)
        camera = None if pair is None or camera is None else pair.rebased.camera(camera)
        if pair is None or camera is None:
            return None, reason or "a camera lies at infinity"
        rendered = pair.interpolator.interpolate(camera, float(temporal_position(before, after, instant)))
        if self._corrects:
            rendered = corrected(rendered, (before.frame.luma, after.frame.luma), tracks)
        # Frames that have a neighbour on either side are references of none.
        if self._remembers and after.index - before.index > 2:
            _remember(group, pair, instant, rendered)
        return rendered, ""

    def _between(self, group: _Group, around: tuple[ReferenceFrame, ReferenceFrame]) -> _Pair | None:
        before, after = around
        known = self._pair
        if known is not None and known.before is before and known.after is after:
            return known
        rebased = group.geometry.between(before.index, after.index)
        if rebased is None:
            return None
        depths = tuple(
            _known_depth(group, index, after.index - before.index) for index in (before.index, after.index)
        )
        interpolator = self._build(rebased.model, before.frame.luma, after.frame.luma, (depths[0], depths[1]))
        self._pair = _Pair(before, after, rebased, interpolator)
        return self._pair


def _end_to_end(tracks: PointTracks) -> Correspondences:
    """Return the points that are seen in the first and in the last frame, one at each pixel of the first."""
    ends = Correspondences(tracks.positions[:, 0], tracks.positions[:, -1], np.zeros(len(tracks)))
    ends = ends[ends.finite]
    return ends[np.unique(np.rint(ends.first), axis=0, return_index=True)[1]]


def _known_depth(group: _Group, index: int, distance: int) -> KnownDepth:
    """Return the depth of a reference that longer baselines than that of a pair have given."""
    if index not in group.points:
        group.points[index] = group.geometry.known_depth(index)
    found = group.depths.get(index)
    depth = found.depth if found is not None and found.rank[0] > distance else None
    return group.points[index]._replace(depth=depth, is_settled=distance <= SETTLED_DISTANCE)


def _remember(group: _Group, pair: _Pair, instant: int, rendered: Interpolation) -> None:
    """Keep the depth of three frames for those that are decoded later."""
    views = pair.interpolator.views
    depths = {pair.before.index: views[0].depth, pair.after.index: views[1].depth, instant: rendered.depth}
    rank = pair.after.index - pair.before.index, -pair.before.index
    for index, depth in depths.items():
        known = group.depths.get(index)
        if depth is not None and (known is None or known.rank < rank):
            group.depths[index] = _FoundDepth(rank, depth)
