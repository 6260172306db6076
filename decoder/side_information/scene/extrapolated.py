"""P-type frames from the scene: two earlier frames with depth, seen by the camera that tracks tell.

The camera of the wanted frame follows by resection from points of the later frame whose depth is known: from
where the earlier frame saw them, or else from its depth map. These points and the camera are then improved in
turns, since the wanted frame sees them from farther away. What tracks still miss is corrected by smooth
fields, from wide to narrow, as where there is no scene.
"""

import pickle
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decoder.side_information.protocol import Interpolation
from decoder.side_information.residual_fields import WIDE_TO_NARROW
from decoder.side_information.scene.corrections import corrected
from decoder.side_information.scene.synthesis import render_between
from dvc.multiview.cameras import PixelFrame, homogeneous
from dvc.multiview.depth_maps import DepthView
from dvc.multiview.triangulation import TrackDepths, track_depths
from dvc.video import Frame

Floats = NDArray[np.float64]

LATER_SHARE = 0.85
"""Of the later frame where both see a point: it is nearer to the wanted one."""
SAME_POINT_PX = 1.0
"""Distance of points of two groups in the frame that they share, up to which they are the same."""
NUM_TURNS = 3
"""How often points and camera are improved in turns."""
MAX_RMS_PX = 1.0
MAX_SIGMA = 3.0
"""Points that three views do not agree on, or do not locate, keep the depth that they had."""


class Scene(NamedTuple):
    """What two decoded frames show of the scene, and tracks between them."""

    frames: tuple[Frame, Frame]  # the earlier and the later one
    views: tuple[DepthView, DepthView]  # their cameras and depth
    pixel_frame: PixelFrame
    tracks: tuple[Floats, Floats]  # points in both frames, (N, 2) in pixels; nan where one is not seen

    def pack(self) -> bytes:
        """Write it for another process, past those that need not know what is in it."""
        return pickle.dumps(self)

    @classmethod
    def unpack(cls, packed: bytes) -> "Scene":
        """Read what `pack` has written in a process of this program."""
        scene = pickle.loads(packed)
        assert isinstance(scene, cls)
        return scene


def extrapolate(scene: Scene, at_later: Floats, wanted: Floats) -> tuple[Interpolation | None, str]:
    """Predict a frame from where points of the later frame are in it; say why where there is no camera."""
    from sfm.cameras.resection import resection

    frame, (earlier, later) = scene.pixel_frame, scene.views
    at_earlier = _continued(scene.tracks, at_later)
    seen = np.stack([at_earlier, at_later, wanted], axis=1)
    drawn = _drawn_depth(later, at_later)
    cameras: tuple[Floats | None, ...] = earlier.camera, later.camera, None
    prior = later.camera
    for _ in range(1 + NUM_TURNS):
        inverse_depth = _located(track_depths(seen, cameras, 1, frame), drawn)
        found = resection(_points(later, frame, at_later, inverse_depth), wanted, frame, prior=prior)
        if not found.success:
            return None, f"camera: {found.reason}"
        prior = found.camera
        cameras = earlier.camera, later.camera, prior
    rendered = render_between(scene.views, prior, LATER_SHARE, frame)
    lumas = earlier.luma, later.luma
    return corrected(rendered, lumas, (at_earlier, wanted, at_later), WIDE_TO_NARROW), ""


def _continued(tracks: tuple[Floats, Floats], at_later: Floats) -> Floats:
    """Tell where points of the later frame are in the earlier one, where tracks end in the same place."""
    from scipy.spatial import cKDTree

    at_earlier = np.full_like(at_later, np.nan)
    ends = np.flatnonzero(np.isfinite(np.hstack(tracks)).all(axis=1))
    begun = np.flatnonzero(np.isfinite(at_later).all(axis=1))
    if len(ends) and len(begun):
        distance_px, nearest = cKDTree(tracks[1][ends]).query(at_later[begun])
        same = distance_px <= SAME_POINT_PX
        begun, ends = begun[same], ends[nearest[same]]
        at_earlier[begun] = tracks[0][ends] + at_later[begun] - tracks[1][ends]
    return at_earlier


def _drawn_depth(view: DepthView, points: Floats) -> Floats:
    """Look up the inverse depth of points in that of a view; nan where it is not reliable."""
    size = np.array(view.luma.shape[::-1])
    column, row = np.clip(np.floor(np.nan_to_num(points, nan=-1.0) + 0.5), -1, size).astype(np.int64).T
    inside = (column >= 0) & (row >= 0) & (column < size[0]) & (row < size[1])
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    known = inside & view.depth.reliable[row, column]
    return np.where(known, view.depth.inverse_depth[row, column], np.nan)


def _located(tracked: TrackDepths, drawn: Floats) -> Floats:
    """Take the depth that tracks agree on where none is drawn, which is finer than theirs."""
    good = (tracked.rms_px <= MAX_RMS_PX) & (tracked.sigma_px <= MAX_SIGMA)
    return np.where(np.isfinite(drawn) | ~good, drawn, tracked.inverse_depth)


def _points(view: DepthView, frame: PixelFrame, places: Floats, inverse_depth: Floats) -> Floats:
    """Return the points of the scene (N, 4) that a view sees at places; nan where nothing is known."""
    to_view = np.vstack([view.camera, [0.0, 0.0, 0.0, 1.0]])
    rays = homogeneous(frame.to_normalized(places))
    points: Floats = np.column_stack([rays, inverse_depth]) @ np.linalg.inv(to_view).T
    return points
