"""Geometry of a group of pictures: a model from its key frames, and a camera for every frame from tracks."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dvc.multiview.cameras import oriented
from dvc.multiview.depth_maps import KnownDepth
from dvc.multiview.triangulation import track_depths
from dvc.tracks import FeaturePoints, PointTracks
from sfm.cameras.rebasing import Rebased, rebase
from sfm.model import Model, Reconstruction

Floats = NDArray[np.float64]
Luma = NDArray[np.uint8]

MAX_TRACK_RMS_PX = 1.5
"""Tracks farther from where the cameras see their points are wrong, or on something that moves."""
MAX_TRACK_SIGMA = 6.0
"""Tracks whose point may be off by more than this many times the tracker's error have no reliable depth."""


@dataclass(frozen=True, eq=False)
class GroupGeometry:
    """What is known of the scene and the camera in one group of pictures.

    Attributes
    ----------
    first_index : int
        Display position of the first key frame.
    tracks : PointTracks
        Tracked points.
    model : Model or None
        The scene, from the two key frames; None where there is none that can be trusted.
    cameras : tuple of (ndarray of shape (3, 4), float64, or None)
        Camera of each frame, key frames included, in the basis of the model; None where there is none.
    reason : str
        Why the model is missing.
    camera_reasons : tuple of str
        Why cameras are missing.
    hopeful : bool
        Whether there may be a scene between frames of the group where there is none between its ends: not
        where the camera only turned, or stood still.
    """

    first_index: int
    tracks: PointTracks
    model: Model | None
    cameras: tuple[Floats | None, ...]
    reason: str
    camera_reasons: tuple[str, ...]
    hopeful: bool

    def positions(self, index: int) -> Floats:
        """Return where the points are in one frame.

        Parameters
        ----------
        index : int
            Display position of the frame.

        Returns
        -------
        ndarray of shape (N, 2), float64
            (x, y) in pixels; nan where a point is not known.
        """
        positions: Floats = self.tracks.positions[:, index - self.first_index]
        return positions

    def camera(self, index: int) -> Floats | None:
        """Return the camera of one frame.

        Parameters
        ----------
        index : int
            Display position of the frame.

        Returns
        -------
        ndarray of shape (3, 4), float64, or None
            In the basis of the model.
        """
        return self.cameras[index - self.first_index]

    def part(self, first: int, last: int) -> PointTracks:
        """Return the tracks between two frames.

        Parameters
        ----------
        first, last : int
            Display positions.

        Returns
        -------
        PointTracks
            Of all points, whether they are seen there or not.
        """
        return PointTracks(self.tracks.positions[:, first - self.first_index : last + 1 - self.first_index])

    def missing(self, *indices: int) -> str:
        """Say why the scene cannot be used with some frames; nothing if it can.

        Parameters
        ----------
        *indices : int
            Display positions.

        Returns
        -------
        str
            The reason.
        """
        reasons = (self.camera_reasons[index - self.first_index] for index in indices)
        return self.reason or next((reason for reason in reasons if reason), "")

    def between(self, first: int, second: int) -> Rebased | None:
        """Describe the scene by two frames of the group.

        Parameters
        ----------
        first, second : int
            Display positions; both frames must have cameras.

        Returns
        -------
        Rebased or None
            The model of the two, None where there is none.
        """
        cameras = self.camera(first), self.camera(second)
        if self.model is None or cameras[0] is None or cameras[1] is None:
            return None
        return rebase(self.model, cameras[0], cameras[1])

    def known_depth(self, index: int) -> KnownDepth:
        """Return the depth of the points that one frame sees, from all frames that see them.

        Parameters
        ----------
        index : int
            Display position; the frame must have a camera.

        Returns
        -------
        KnownDepth
            Of the points whose tracks agree with the cameras and determine a depth.
        """
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
    rigid: bool = False,
) -> GroupGeometry:
    """Find the cameras of a group of pictures.

    Parameters
    ----------
    reconstruction : Reconstruction
        The scene as the key frames show it.
    keys : tuple of two ndarray of shape (H, W), uint8
        Luma of the key frames.
    points : PointTracks or FeaturePoints
        What the encoder sent.
    first_index : int
        Display position of the first key frame.
    path_regularity : float, optional
        Weight of the second differences of the camera's path, see `regular_cameras`.
    rigid : bool, optional
        Whether depths are put in the order in which a rigid motion sees them, see `rigid_order`.

    Returns
    -------
    GroupGeometry
        With the reasons of what is missing.

    References
    ----------
    [Maitre2008] Sec. 5.4: (5.7) with real tracks instead of (5.8).
    """
    from decoder.tracking import match_points
    from sfm.cameras.camera_path import regular_cameras
    from sfm.cameras.tracked_points import tracked_points

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
    return in_rigid_order(geometry) if rigid else geometry


def in_rigid_order(geometry: GroupGeometry) -> GroupGeometry:
    """Put the depths of a group of pictures in the order in which a rigid motion sees them.

    Parameters
    ----------
    geometry : GroupGeometry
        With a model.

    Returns
    -------
    GroupGeometry
        The same, or all of it in the basis that has the depths so: where points are seen stays.
    """
    from sfm.cameras.depth_order import rigid_order

    assert geometry.model is not None
    ordered = rigid_order(geometry.model)
    if ordered is None:
        return geometry
    cameras = [None if camera is None else ordered.camera(oriented(camera)) for camera in geometry.cameras]
    return replace(geometry, model=ordered.model, cameras=tuple(cameras))
