"""From where a scene is seen as a whole."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfm.mapping.scene_map import MapPiece

Floats = NDArray[np.float64]

MOST = 0.75
"""Share of the points that are in the view."""
CAMERAS = 0.3
"""Weight of the cameras in the middle."""
AHEAD = 10.0
"""Distance that is looked at where nothing is known, in lengths of the path or units."""


def overview(piece: MapPiece) -> dict[str, Any]:
    """Return what is up and ahead, the middle of the scene, and within which radius of it nearly all is."""
    poses = np.array([piece.poses[number] for number in sorted(piece.poses)])
    centres = -np.einsum("kji,kj->ki", poses[:, :, :3], poses[:, :, 3])
    up, ahead = _unit(-poses[:, 1, :3].mean(axis=0)), _unit(poses[:, 2, :3].mean(axis=0))
    path = float(np.linalg.norm(np.ptp(centres, axis=0)))
    points = piece.points[np.isfinite(piece.points).all(axis=1)]
    if len(points) == 0:
        points = centres + AHEAD * (path or 1.0) * poses[:, 2, :3]
    middle = (1.0 - CAMERAS) * np.median(points, axis=0) + CAMERAS * centres.mean(axis=0)
    away = np.linalg.norm(points - middle, axis=1)
    to_cameras = float(np.linalg.norm(centres - middle, axis=1).max())
    return {
        "up": up.tolist(),
        "ahead": ahead.tolist(),
        "middle": middle.tolist(),
        "radius": max(float(np.quantile(away, MOST)), to_cameras, 1e-9),
        "path": path,
        "depth": max(float(np.median((points - centres.mean(axis=0)) @ ahead)), 0.05 * to_cameras, 1e-9),
    }


def _unit(vector: Floats) -> Floats:
    """Return a direction; any where there is none."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
