"""Scenes to look at: pictures with disparities and masks, where they were taken from, and how far to go.

A *source* is what one viewpoint sees, in one piece or in several behind each other; several sources show the
same scene. Streams become that here, layers and sprites in `dvc.dibr.viewer.canvases`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.layered.bounds import Bounds, bounds_around, bounds_of_one
from dvc.dibr.view_rendering import DecodedViews, continued
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.viewpoints import CalibratedViewpoint, Viewpoint, distance
from dvc.layers.canvas import DEPTH_RANGE

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Piece(NamedTuple):
    """A surface as one viewpoint sees it."""

    picture: NDArray[np.uint8]  # red, green and blue; beside the mask continued from it
    disparity: Floats  # in pixels per unit of m and n; of calibrated cameras, inverse depth
    mask: Mask  # where there is something
    left: int = 0  # column and row of its first pixel in the picture of the viewpoint
    top: int = 0


class Source(NamedTuple):
    """What one viewpoint sees."""

    viewpoint: Viewpoint  # where it is
    pieces: tuple[Piece, ...]  # surfaces, near ones before far ones wherever they meet


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene."""

    shape: tuple[int, int]  # height and width of a view, in pixels
    # at least one, of viewpoints of one kind; the first one is where a visit begins
    sources: tuple[Source, ...]
    step: float  # neighbours whose disparities differ by at most 1.5 of it are one surface
    viewpoints: tuple[Viewpoint, ...]  # of all views that are known, the first source's first
    bounds: Bounds  # how far the viewpoint may be moved

    @property
    def num_pixels(self) -> int:
        """Of all pieces together."""
        return sum(piece.mask.size for source in self.sources for piece in source.pieces)

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest disparity."""
        values = [piece.disparity[piece.mask] for source in self.sources for piece in source.pieces]
        known = [each for each in values if each.size]
        if not known:
            return 0.0, 0.0
        return min(float(each.min()) for each in known), max(float(each.max()) for each in known)

    @property
    def extent(self) -> float:
        """From the least disparity to the largest, at least a step; 1 where both are nothing."""
        lowest, highest = self.range
        return max(highest - lowest, self.step) or 1.0

    @property
    def infinity(self) -> float:
        """Disparity of what is infinitely far; where it is not known, below all others."""
        lowest, highest = self.range
        is_calibrated = isinstance(self.viewpoints[0], CalibratedViewpoint)
        if is_calibrated or (lowest > 0.0 and highest <= DEPTH_RANGE * lowest):
            return 0.0
        return lowest - self.extent / (DEPTH_RANGE - 1.0)


def source_of(
    picture: NDArray[np.uint8],
    disparity: Floats,
    mask: Mask | None = None,
    viewpoint: Viewpoint | None = None,
) -> Source:
    """Return what a picture with a map of its disparities shows."""
    known = np.ones(disparity.shape, np.bool_) if mask is None else mask
    return Source(viewpoint or LatticePosition(0.0, 0.0), (piece_of(picture, disparity, known),))


def scene_of_picture(source: Source, step: float) -> Scene:
    """Return the scene of a single picture with disparities."""
    height, width = source.pieces[0].disparity.shape
    scene = Scene((height, width), (source,), step, (source.viewpoint,), Bounds(0.0, 0.0, 0.0, 0.0))
    return replace(scene, bounds=bounds_of_one(width, scene.extent))


def scene_of_stream(decoded: DecodedViews) -> Scene:
    """Return the scene of a decoded stream."""
    sources = tuple(source_of(pair.picture, pair.disparity, None, pair.viewpoint) for pair in decoded.pairs)
    step, viewpoints = decoded.step, decoded.viewpoints
    if len(viewpoints) == 1:
        return scene_of_picture(sources[0], step)
    height, width = decoded.pairs[0].disparity.shape
    across, down, _ = positions_of(viewpoints).T.tolist()
    bounds = bounds_around(min(across), max(across), min(down), max(down))
    return Scene((height, width), sources, step, viewpoints, bounds)


def piece_of(picture: NDArray[np.uint8], disparity: NDArray[np.floating], mask: Mask) -> Piece:
    """Return a picture as a piece, in three channels and continued a little beyond its mask."""
    image = picture.reshape(*picture.shape[:2], -1)
    image = np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image
    return Piece(continued(image, mask), disparity.astype(np.float64), mask)


def is_whole(source: Source, shape: tuple[int, int]) -> bool:
    """Tell whether a source is one piece that is all of its view."""
    first = source.pieces[0]
    position = first.left, first.top
    return (
        len(source.pieces) == 1
        and first.mask.shape == shape
        and position == (0, 0)
        and bool(first.mask.all())
    )


def seen_of(source: Source, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Return what a source shows at its own viewpoint."""
    picture, nearest = np.zeros((*shape, 3), np.uint8), np.full(shape, -np.inf)
    for piece in source.pieces:
        y, x = (
            index + first
            for index, first in zip(np.nonzero(piece.mask), (piece.top, piece.left), strict=True)
        )
        inside = (x >= 0) & (y >= 0) & (x < shape[1]) & (y < shape[0])
        y, x, disparity = y[inside], x[inside], piece.disparity[piece.mask][inside]
        front = disparity > nearest[y, x]
        nearest[y[front], x[front]] = disparity[front]
        picture[y[front], x[front]] = piece.picture[piece.mask][inside][front]
    return picture


def positions_of(viewpoints: Sequence[Viewpoint]) -> Floats:
    """Return where viewpoints are, as the viewer moves."""
    first = viewpoints[0]
    if isinstance(first, LatticePosition):
        return np.array([[*view, 0.0] for view in viewpoints if isinstance(view, LatticePosition)])
    views = [view for view in viewpoints if isinstance(view, CalibratedViewpoint)]
    return np.asarray([view.centre - first.centre for view in views] @ first.pose[:, :3].T / unit_of(views))


def unit_of(viewpoints: Sequence[CalibratedViewpoint]) -> float:
    """Return how far the farthest camera is from the first, which is a unit of m and n."""
    return max(distance(viewpoints[0], view) for view in viewpoints) or 1.0
