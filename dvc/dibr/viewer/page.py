"""The page of the viewer: one file with a scene and the programs that draw it, which loads nothing."""

import base64
import zlib
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.dibr.viewer.scene import Piece, Scene, Source, is_whole, positions_of, seen_of, unit_of
from dvc.files import atomic_output
from dvc.multiview.camera_array import LatticePosition
from dvc.multiview.viewpoints import CalibratedViewpoint
from dvc.page.document import asset, content_policy, data_uri, script_json, template
from dvc.page.drawing import colour_disparity

Floats = NDArray[np.float64]

TEMPLATES = resources.files("dvc.dibr.viewer") / "templates"
SCRIPTS = ("warps.js", "decoding.js", "renderer.js", "viewer.js")
"""In this order; each needs those before it."""
SHADERS = ("surface.vert", "surface.frag", "view.vert", "view.frag")
MAX_CODE = 2**16 - 1
"""Disparities are whole numbers from 1 to this; 0 is where there is nothing."""
LOSSLESS = 101
"""Quality of WebP that keeps every level."""
STILL_QUALITY = 85
"""Of a picture that is only shown where nothing can be drawn."""


@dataclass(frozen=True)
class Caption:
    """What the page says of a scene."""

    title: str  # its name
    kind: str  # what it was made of, for the heading
    num_bytes: int  # size of what it was read from
    num_pixels: int  # of a view as it was coded, for the rate
    notes: tuple[str, ...] = ()  # what else a visitor must know
    qualities: tuple[float | None, ...] = ()  # PSNR of each viewpoint in dB; None where it is not known

    @property
    def bits_per_pixel(self) -> float:
        """The rate."""
        return 8 * self.num_bytes / self.num_pixels


def write_page(path: str | Path, scene: Scene, caption: Caption) -> None:
    """Write the page."""
    scripts = {name.removesuffix(".js"): asset(TEMPLATES, name) for name in SCRIPTS}
    shaders = {name: asset(TEMPLATES, name) for name in SHADERS}
    values = scene_values(scene, caption)
    text = template(TEMPLATES, "viewer.html.j2").render(
        caption=caption,
        scene=scene,
        views=values["views"],
        cameras=values["cameras"],
        scene_json=script_json(values),
        shaders_json=script_json(shaders),
        still=_still(scene),
        css=asset(TEMPLATES, "viewer.css"),
        policy=content_policy(scripts.values()),
        scripts=scripts,
    )
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def scene_values(scene: Scene, caption: Caption) -> dict[str, Any]:
    """Return what the programs of the page are told."""
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
        "palette": base64.b64encode(_palette().tobytes()).decode("ascii"),
    }


def _cameras(scene: Scene, positions: Floats) -> dict[str, Any] | None:
    """Where calibrated cameras stand and look; None on a lattice."""
    views = [view for view in scene.viewpoints if isinstance(view, CalibratedViewpoint)]
    if not views:
        return None
    axes = unit_of(views) * views[0].pose[:, :3]
    return {
        "origin": views[0].centre.tolist(),
        "axes": axes.ravel().tolist(),
        "views": [
            {"position": position.tolist(), **_camera_values(view)}
            for position, view in zip(positions, views, strict=True)
        ],
    }


def _camera_values(view: CalibratedViewpoint) -> dict[str, Any]:
    return {
        "intrinsic": view.intrinsic.ravel().tolist(),
        "rotation": view.pose[:, :3].ravel().tolist(),
        "centre": view.centre.tolist(),
    }


def _source_values(source: Source, is_still: bool) -> dict[str, Any]:
    viewpoint = source.viewpoint
    return {
        "position": list(viewpoint) if isinstance(viewpoint, LatticePosition) else None,
        "camera": _camera_values(viewpoint) if isinstance(viewpoint, CalibratedViewpoint) else None,
        "pieces": [_piece_values(piece, is_still) for piece in source.pieces],
    }


def _piece_values(piece: Piece, is_still: bool) -> dict[str, Any]:
    codes, lowest, unit = disparity_codes(piece)
    height, width = codes.shape
    return {
        "left": piece.left,
        "top": piece.top,
        "width": width,
        "height": height,
        "lowest": lowest,
        "unit": unit,
        "codes": base64.b64encode(pack_codes(codes)).decode("ascii"),
        "picture": None if is_still else base64.b64encode(_webp(piece.picture)).decode("ascii"),
    }


def disparity_codes(piece: Piece) -> tuple[NDArray[np.uint16], float, float]:
    """Return the disparities of a piece as whole numbers."""
    values = piece.disparity[piece.mask]
    lowest, highest = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    unit = (highest - lowest) / (MAX_CODE - 1) if highest > lowest else 1.0
    codes = np.zeros(piece.disparity.shape, np.uint16)
    codes[piece.mask] = 1 + np.rint((values - lowest) / unit).astype(np.uint16)
    return codes, lowest, unit


def pack_codes(codes: NDArray[np.uint16]) -> bytes:
    """Return codes as few bytes: differences along rows, high and low bytes apart, deflated."""
    differences = np.diff(codes, axis=1, prepend=np.uint16(0))
    planes = np.stack([differences >> 8, differences & 255]).astype(np.uint8)
    return zlib.compress(planes.tobytes(), 9)


def _webp(picture: NDArray[np.uint8], quality: int = LOSSLESS) -> bytes:
    _, coded = cv2.imencode(".webp", picture[:, :, ::-1], [cv2.IMWRITE_WEBP_QUALITY, quality])
    return coded.tobytes()


def _still(scene: Scene) -> str:
    """Address of what the first viewpoint sees: its only picture, or one for this purpose alone."""
    first = scene.sources[0]
    if is_whole(first, scene.shape):
        return data_uri("image/webp", _webp(first.pieces[0].picture))
    return data_uri("image/webp", _webp(seen_of(first, scene.shape), STILL_QUALITY))


def _palette() -> NDArray[np.uint8]:
    """Red, green and blue from far to near, shape (256, 3)."""
    return np.ascontiguousarray(colour_disparity(np.linspace(0.0, 1.0, 256)[None], 0.0, 1.0)[0, :, ::-1])
