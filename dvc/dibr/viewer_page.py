"""The page of the viewer: one file with a scene and the programs that draw it, which loads nothing."""

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.viewer_scene import Piece, Scene, Source, is_whole, positions_of, seen_of, unit_of
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.viewpoints import CalibratedViewpoint
from dvc.web.document import data_uri
from dvc.web.surfaces import StageFiles, camera_values, palette_text, surface_values, webp, write_stage

Floats = NDArray[np.float64]

FILES = StageFiles(resources.files("dvc.dibr") / "templates", "viewer.html.j2", ("warps.js", "viewer.js"))
STILL_QUALITY = 85
"""Quality of a picture that is only shown if nothing can be drawn."""


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
    values = scene_values(scene, caption)
    write_stage(
        path,
        FILES,
        values,
        title=caption.title,
        width=scene.shape[1],
        height=scene.shape[0],
        still=_still(scene),
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
    views = [
        {"m": float(position[0]), "n": float(position[1]), "psnr_db": quality}
        for position, quality in zip(positions, qualities, strict=True)
    ]
    return {
        "name": Path(caption.title).stem,
        "width": scene.shape[1],
        "height": scene.shape[0],
        "step": scene.step,
        "infinity": scene.infinity,
        "lowest": lowest,
        "highest": lowest + scene.extent,
        "bounds": scene.bounds._asdict(),
        "views": views,
        "cameras": _cameras(scene, positions),
        "sources": [
            _source_values(source, index == 0 and is_whole(source, scene.shape))
            for index, source in enumerate(scene.sources)
        ],
        "palette": palette_text(),
    }


def _cameras(scene: Scene, positions: Floats) -> dict[str, Any] | None:
    """Return poses of calibrated cameras; None on a lattice."""
    views = [view for view in scene.viewpoints if isinstance(view, CalibratedViewpoint)]
    if not views:
        return None
    axes = unit_of(views) * views[0].pose[:, :3]
    return {
        "origin": views[0].centre.tolist(),
        "axes": axes.ravel().tolist(),
        "views": [
            {"position": position.tolist(), **camera_values(view.intrinsic, view.pose)}
            for position, view in zip(positions, views, strict=True)
        ],
    }


def _source_values(source: Source, is_still: bool) -> dict[str, Any]:
    viewpoint = source.viewpoint
    camera = None
    if isinstance(viewpoint, CalibratedViewpoint):
        camera = camera_values(viewpoint.intrinsic, viewpoint.pose)
    return {
        "position": list(viewpoint) if isinstance(viewpoint, LatticePosition) else None,
        "camera": camera,
        "pieces": [_piece_values(piece, is_still) for piece in source.pieces],
    }


def _piece_values(piece: Piece, is_still: bool) -> dict[str, Any]:
    picture = None if is_still else webp(piece.picture)
    values = surface_values(piece.disparity, piece.mask, picture)
    return {**values, "left": piece.left, "top": piece.top}


def _still(scene: Scene) -> str:
    """Return the address of the view of the first viewpoint: its only picture, or one for this purpose."""
    first = scene.sources[0]
    if is_whole(first, scene.shape):
        return data_uri("image/webp", webp(first.pieces[0].picture))
    return data_uri("image/webp", webp(seen_of(first, scene.shape), STILL_QUALITY))
