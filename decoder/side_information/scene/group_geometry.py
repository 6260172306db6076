"""Geometry of a group of pictures: a model from its key frames, and a camera for every frame from tracks."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import oriented
from dvc.geometry.depth_maps import KnownDepth
from dvc.geometry.triangulation import track_depths
from dvc.tracks import FeaturePoints, PointTracks
from sfm.cameras.rebasing import Rebased, rebase
from sfm.scene_model import Model, Reconstruction

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]

MAX_TRACK_RMS_PX = 1.5
"""Tracks farther from where the cameras see their points are wrong, or on something that moves."""
MAX_TRACK_SIGMA = 6.0
"""Tracks whose point may be off by more than this many times the tracker's error have no reliable depth."""


@dataclass(frozen=True, eq=False)
class GroupGeometry:
    """What is known of the scene and the camera in one group of pictures."""

    first_index: int  # display position of the first key frame
    tracks: PointTracks  # tracked points
    model: Model | None  # the scene, from the two key frames; None where there is none that can be trusted
    # camera of each frame, key frames included, in the basis of the model; None where there is none
    cameras: tuple[Floats | None, ...]
    reason: str  # why the model is missing
    camera_reasons: tuple[str, ...]  # why cameras are missing
    # whether there may be a scene between frames of the group where there is none between its ends: not where
    # the camera only turned, or stood still
    hopeful: bool

    def positions(self, index: int) -> Floats:
        """Return where the points are in one frame."""
        positions: Floats = self.tracks.positions[:, index - self.first_index]
        return positions

    def camera(self, index: int) -> Floats | None:
        """Return the camera of one frame."""
        return self.cameras[index - self.first_index]

    def part(self, first: int, last: int) -> PointTracks:
        """Return the tracks between two frames."""
        return PointTracks(self.tracks.positions[:, first - self.first_index : last + 1 - self.first_index])

    def missing(self, *indices: int) -> str:
        """Say why the scene cannot be used with some frames; nothing if it can."""
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
    keys: tuple[Luma, Luma],
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
        hopeful = reconstruction.motion not in ("rotation", "none")
        return GroupGeometry(first_index, tracks, None, none, reconstruction.reason, ("",) * number, hopeful)
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
    """Put the depths of a group of pictures in the order in which a rigid motion sees them."""
    from sfm.cameras.rebasing import rigid_order

    assert geometry.model is not None
    ordered = rigid_order(geometry.model)
    if ordered is None:
        return geometry
    cameras = [None if camera is None else ordered.camera(oriented(camera)) for camera in geometry.cameras]
    return replace(geometry, model=ordered.model, cameras=tuple(cameras))
