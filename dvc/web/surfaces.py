"""Pictures with depth in a page: compact data, and the scripts and shaders that draw them."""

import base64
import zlib
from collections.abc import Mapping
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.web.document import SHARED, asset, render_page, script_json, write_text
from dvc.web.drawing import colour_disparity

Floats = NDArray[np.float64]

SCRIPTS = ("matrices.js", "decoding.js", "renderer.js", "stage.js")
"""Shared scripts; each needs those before it."""
SHADERS = ("surface.vert", "surface.frag", "view.vert", "view.frag")
MAX_CODE = 2**16 - 1
"""Largest code of a disparity; the least is 1, and 0 means no surface."""
LOSSLESS = 101
"""Quality of lossless WebP."""


class StageFiles(NamedTuple):
    """Assets of a page about a scene besides the shared ones."""

    folder: Traversable
    template: str  # extends ``stage.html.j2``
    scripts: tuple[str, ...]  # each needs those before it
    shaders: tuple[str, ...] = ()
    styles: tuple[str, ...] = ()


def write_stage(path: str | Path, files: StageFiles, values: Mapping[str, Any], **shown: Any) -> None:
    """Write a page about a scene, with `values` for its scripts and `shown` for its template."""
    folder = files.folder
    scripts = [asset(SHARED, name) for name in SCRIPTS] + [asset(folder, name) for name in files.scripts]
    shaders = {name: asset(SHARED, name) for name in SHADERS}
    shaders |= {name: asset(folder, name) for name in files.shaders}
    page = render_page(
        folder,
        files.template,
        css=[asset(SHARED, "stage.css"), *(asset(folder, name) for name in files.styles)],
        scripts=scripts,
        scene_json=script_json(values),
        shaders_json=script_json(shaders),
        **shown,
    )
    write_text(path, page)


def disparity_codes(
    disparity: NDArray[np.floating], mask: NDArray[np.bool_], max_code: int = MAX_CODE
) -> tuple[NDArray[np.uint16], float, float]:
    """Return disparities as codes from 1, with the least disparity and the unit."""
    values = disparity[mask].astype(np.float64)
    lowest, highest = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    unit = (highest - lowest) / (max_code - 1) if highest > lowest else 1.0
    codes = np.zeros(disparity.shape, np.uint16)
    codes[mask] = 1 + np.rint((values - lowest) / unit).astype(np.uint16)
    return codes, lowest, unit


def pack_codes(codes: NDArray[np.uint16]) -> bytes:
    """Compress codes: differences along rows, high and low bytes apart, deflated."""
    differences = np.diff(codes, axis=1, prepend=np.uint16(0))
    planes = np.stack([differences >> 8, differences & 255]).astype(np.uint8)
    return zlib.compress(planes.tobytes(), 9)


def surface_values(
    disparity: NDArray[np.floating], mask: NDArray[np.bool_], picture: bytes | None, max_code: int = MAX_CODE
) -> dict[str, Any]:
    """Return a surface for the scripts of a page; without a picture it shows the page's still."""
    codes, lowest, unit = disparity_codes(disparity, mask, max_code)
    height, width = codes.shape
    return {
        "left": 0,
        "top": 0,
        "width": width,
        "height": height,
        "lowest": lowest,
        "unit": unit,
        "codes": base64_text(pack_codes(codes)),
        "picture": None if picture is None else base64_text(picture),
    }


def camera_values(intrinsic: Floats, pose: Floats) -> dict[str, Any]:
    """Return a calibrated camera, [R | t] from the world to it, for the scripts of a page."""
    return {
        "intrinsic": intrinsic.ravel().tolist(),
        "rotation": pose[:, :3].ravel().tolist(),
        "centre": (-pose[:, :3].T @ pose[:, 3]).tolist(),
    }


def palette_text() -> str:
    """Return 256 colours from far to near, as base64."""
    colours = colour_disparity(np.linspace(0.0, 1.0, 256)[None], 0.0, 1.0)[0, :, ::-1]
    return base64_text(np.ascontiguousarray(colours).tobytes())


def webp(picture: NDArray[np.uint8], quality: int = LOSSLESS) -> bytes:
    """Encode a picture of red, green and blue."""
    _, coded = cv2.imencode(".webp", picture[:, :, ::-1], [cv2.IMWRITE_WEBP_QUALITY, quality])
    return coded.tobytes()


def base64_text(content: bytes) -> str:
    """Return bytes as base64."""
    return base64.b64encode(content).decode("ascii")
