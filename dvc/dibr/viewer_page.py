"""The page of the viewer: one file with a scene and the programs that draw it, which loads nothing.

A scene has pictures with disparities and masks, their viewpoints, and bounds of the viewpoint. A *source* is
the view of one viewpoint, in one piece or in several behind each other; several sources show the same scene.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Floats, Mask
from dvc.dibr.depth_image.scene_pieces import (
    Bounds,
    Kind,
    Pieces,
    bounds_around,
    bounds_of_one,
    bounds_of_pieces,
    layers_of,
)
from dvc.dibr.view_rendering import DecodedViews, with_margin
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.viewpoints import CalibratedViewpoint, Viewpoint, distance
from dvc.layers.canvas import DEPTH_RANGE
from dvc.layers.sprites import Sprite
from dvc.web.document import data_uri
from dvc.web.surfaces import StageFiles, camera_values, palette_text, surface_values, webp, write_stage

FILES = StageFiles(resources.files("dvc.dibr") / "templates", "viewer.html.j2", ("warps.js", "viewer.js"))
STILL_QUALITY = 85
"""Quality of a picture that is only shown if nothing can be drawn."""


class Piece(NamedTuple):
    """A surface as one viewpoint sees it."""

    picture: NDArray[np.uint8]  # red, green and blue; continued around the mask
    disparity: Floats  # pixels per unit of m and n; inverse depth for calibrated cameras
    mask: Mask  # pixels of the surface
    left: int = 0  # column and row of its first pixel in the view
    top: int = 0


class Source(NamedTuple):
    """The view of one viewpoint."""

    viewpoint: Viewpoint
    pieces: tuple[Piece, ...]  # surfaces, near before far if they overlap


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene."""

    shape: tuple[int, int]  # height and width of a view, in pixels
    # at least one, of viewpoints of one kind; a visit begins at the first
    sources: tuple[Source, ...]
    step: float  # neighbours whose disparities differ by at most 1.5 of it are one surface
    viewpoints: tuple[Viewpoint, ...]  # viewpoints of all known views, that of the first source first
    bounds: Bounds  # bounds of the viewpoint

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
        """Range of disparities, at least a step; 1 if both are zero."""
        lowest, highest = self.range
        return max(highest - lowest, self.step) or 1.0

    @property
    def infinity(self) -> float:
        """Disparity of infinity; if it is unknown, below all disparities."""
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
    """Return the source of a picture with its disparities."""
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
    """Return a picture as a piece, in three channels and with a margin around its mask."""
    image = picture.reshape(*picture.shape[:2], -1)
    image = np.repeat(image, 3, axis=2) if image.shape[2] == 1 else image
    return Piece(with_margin(image, mask), disparity.astype(np.float64), mask)


def is_whole(source: Source, shape: tuple[int, int]) -> bool:
    """Return whether a source is one piece that fills its view."""
    first, *rest = source.pieces
    is_first = (first.left, first.top) == (0, 0) and first.mask.shape == shape
    return is_first and not rest and bool(first.mask.all())


def seen_of(source: Source, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the view of a source at its own viewpoint."""
    picture, nearest = np.zeros((*shape, 3), np.uint8), np.full(shape, -np.inf)
    for piece in source.pieces:
        y, x = np.nonzero(piece.mask)
        y, x = y + piece.top, x + piece.left
        inside = (x >= 0) & (y >= 0) & (x < shape[1]) & (y < shape[0])
        y, x, disparity = y[inside], x[inside], piece.disparity[piece.mask][inside]
        front = disparity > nearest[y, x]
        nearest[y[front], x[front]] = disparity[front]
        picture[y[front], x[front]] = piece.picture[piece.mask][inside][front]
    return picture


def positions_of(viewpoints: Sequence[Viewpoint]) -> Floats:
    """Return the positions of viewpoints in coordinates of the viewer."""
    first = viewpoints[0]
    if isinstance(first, LatticePosition):
        return np.array([[*view, 0.0] for view in viewpoints if isinstance(view, LatticePosition)])
    views = [view for view in viewpoints if isinstance(view, CalibratedViewpoint)]
    return np.asarray([view.centre - first.centre for view in views] @ first.pose[:, :3].T / unit_of(views))


def unit_of(viewpoints: Sequence[CalibratedViewpoint]) -> float:
    """Return the distance of the farthest camera from the first, which is a unit of m and n."""
    return max(distance(viewpoints[0], view) for view in viewpoints) or 1.0


def scene_of_pieces(scene: Pieces) -> Scene:
    """Return the scene of layers or sprites, moved so that the reference view begins at (0, 0)."""
    canvas, frame = scene.canvas, scene.canvas.frame
    if scene.kind is Kind.LAYERS:
        image = layers_of(scene)
        planes = list(zip(image.colour, image.disparity, image.occupied, strict=True))
    else:
        planes = [(plane[0], plane[1], plane[2]) for plane in _planes(scene.pieces, canvas.shape)]
    pieces = []
    for plane in planes:
        piece = piece_of(*plane)
        left, top, width, height = cv2.boundingRect(piece.mask.astype(np.uint8))
        inside = slice(top, top + height), slice(left, left + width)
        if width:
            picture, disparity, mask = piece.picture[inside], piece.disparity[inside], piece.mask[inside]
            pieces.append(Piece(picture, disparity, mask, left - frame.left, top - frame.top))
    source = Source(LatticePosition(0.0, 0.0), tuple(pieces))
    shape = frame.height, frame.width
    return Scene(shape, (source,), canvas.resolution, (source.viewpoint,), bounds_of_pieces(scene))


def _planes(sprites: Sequence[Sprite], shape: tuple[int, int]) -> list[list[NDArray[Any]]]:
    """Return sprites on few planes: their colours, disparities and masks, and the pixels next to them."""
    planes: list[list[NDArray[Any]]] = []
    for sprite in sorted(sprites, key=lambda each: -each.num_values):
        inside = sprite.slices
        plane = next((each for each in planes if not (each[3][inside] & sprite.mask).any()), None)
        if plane is None:
            colour, taken = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.bool_)
            plane = [colour, np.zeros(shape), taken.copy(), taken]
            planes.append(plane)
        colour, disparity, mask, taken = plane
        colour[inside][sprite.mask] = sprite.colour[sprite.mask]
        disparity[inside][sprite.mask] = sprite.disparity[sprite.mask]
        mask[inside] |= sprite.mask
        around = tuple(slice(max(side.start - 1, 0), side.stop + 1) for side in inside)
        taken[around] |= cv2.dilate(mask[around].astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return planes


@dataclass(frozen=True)
class Caption:
    """Text of the page about a scene."""

    title: str  # name of the scene
    kind: str  # kind of its file, for the heading
    num_bytes: int  # size of its files
    num_pixels: int  # pixels of a coded view, for the rate
    notes: tuple[str, ...] = ()  # further notes
    qualities: tuple[float | None, ...] = ()  # PSNR of each viewpoint in dB; None: unknown

    @property
    def bits_per_pixel(self) -> float:
        """The rate."""
        return 8 * self.num_bytes / self.num_pixels


def write_page(path: str | Path, scene: Scene, caption: Caption) -> None:
    """Write the page."""
    values, first = scene_values(scene, caption), scene.sources[0]
    if is_whole(first, scene.shape):
        still = webp(first.pieces[0].picture)
    else:
        still = webp(seen_of(first, scene.shape), STILL_QUALITY)
    write_stage(
        path,
        FILES,
        values,
        title=caption.title,
        width=scene.shape[1],
        height=scene.shape[0],
        still=data_uri("image/webp", still),
        caption=caption,
        scene=scene,
        views=values["views"],
        cameras=values["cameras"],
    )


def scene_values(scene: Scene, caption: Caption) -> dict[str, Any]:
    """Return the data of the programs of the page."""
    lowest, _ = scene.range
    positions = positions_of(scene.viewpoints)
    qualities = caption.qualities or (None,) * len(positions)
    sources = []
    for index, (viewpoint, pieces) in enumerate(scene.sources):
        is_still = index == 0 and is_whole(scene.sources[0], scene.shape)
        surfaces = []
        for picture, disparity, mask, left, top in pieces:
            surface = surface_values(disparity, mask, None if is_still else webp(picture))
            surfaces.append({**surface, "left": left, "top": top})
        position, camera = None, None
        if isinstance(viewpoint, LatticePosition):
            position = viewpoint
        else:
            camera = camera_values(viewpoint.intrinsic, viewpoint.pose)
        sources.append({"position": position, "camera": camera, "pieces": surfaces})
    cameras, views = None, [view for view in scene.viewpoints if isinstance(view, CalibratedViewpoint)]
    if views:
        axes = unit_of(views) * views[0].pose[:, :3]
        poses = [
            {"position": position.tolist(), **camera_values(view.intrinsic, view.pose)}
            for position, view in zip(positions, views, strict=True)
        ]
        cameras = {"origin": views[0].centre.tolist(), "axes": axes.ravel().tolist(), "views": poses}
    return {
        "name": Path(caption.title).stem,
        "width": scene.shape[1],
        "height": scene.shape[0],
        "step": scene.step,
        "infinity": scene.infinity,
        "lowest": lowest,
        "highest": lowest + scene.extent,
        "bounds": scene.bounds._asdict(),
        "views": [
            {"m": float(position[0]), "n": float(position[1]), "psnr_db": quality}
            for position, quality in zip(positions, qualities, strict=True)
        ],
        "cameras": cameras,
        "sources": sources,
        "palette": palette_text(),
    }
