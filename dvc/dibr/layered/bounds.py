"""How far from its views a scene may be looked at."""

from typing import NamedTuple

import numpy as np

from dvc.dibr.depth_image.scene_pieces import Pieces

BEYOND = 0.25
"""How far beyond the views a viewpoint may go, relative to the longer side of their lattice."""
ACROSS = 0.1
"""Parallax, relative to the width, that one view alone bears."""
STRAYS = 0.02
"""Share of points beyond the frame of a canvas that may be errors."""


class Bounds(NamedTuple):
    """How far the viewpoint may be moved."""

    left: float  # least and largest m and n
    right: float
    top: float
    bottom: float


def bounds_around(left: float, right: float, top: float, bottom: float) -> Bounds:
    """Return what is a bit beyond the lattice of several views."""
    beyond = BEYOND * max(right - left, bottom - top)
    return Bounds(left - beyond, right + beyond, top - beyond, bottom + beyond)


def bounds_of_one(width: int, extent: float) -> Bounds:
    """Return how far around one view its parallax bears."""
    reach = ACROSS * width / extent
    return Bounds(-reach, reach, -reach, reach)


def bounds_of_pieces(scene: Pieces) -> Bounds:
    """Return what is a bit beyond the cameras that have seen what lies beyond the frame, or around one."""
    frame, step = scene.canvas.frame, scene.canvas.labels.step
    disparity = np.concatenate([np.zeros(0), *(piece.disparity[piece.mask] for piece in scene.pieces)])
    ends = []
    for axis, (first, size) in ((1, (frame.left, frame.width)), (0, (frame.top, frame.height))):
        starts = [(piece.top, piece.left)[axis] - first for piece in scene.pieces]
        places = [
            np.nonzero(piece.mask)[axis] + start for piece, start in zip(scene.pieces, starts, strict=True)
        ]
        position = np.concatenate([np.zeros(0), *places])
        beyond = position - np.clip(position, 0, size - 1)
        counts = (beyond != 0) & (np.abs(disparity) >= step)
        needed = np.append(0.0, beyond[counts] / disparity[counts])
        ends += [min(float(np.quantile(needed, STRAYS)), 0.0)]
        ends += [max(float(np.quantile(needed, 1.0 - STRAYS)), 0.0)]
    if max(map(abs, ends)) > 0.0:
        return bounds_around(*ends)
    extent = float(np.ptp(disparity)) if disparity.size else 0.0
    return bounds_of_one(frame.width, max(extent, scene.canvas.resolution) or 1.0)
