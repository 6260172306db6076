"""Pictures with depth in a page: in few bytes, with the programs and shaders that draw them."""

import base64
import zlib
from collections.abc import Mapping
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.files import atomic_output
from dvc.web.document import SHARED, asset, content_policy, script_json, template
from dvc.web.drawing import colour_disparity

Floats = NDArray[np.float64]

SCRIPTS = ("matrices.js", "decoding.js", "renderer.js", "stage.js")
"""In this order; each needs those before it."""
SHADERS = ("surface.vert", "surface.frag", "view.vert", "view.frag")
MAX_CODE = 2**16 - 1
"""Disparities are whole numbers from 1 to this; 0 is where there is nothing."""
LOSSLESS = 101
"""Quality of WebP that keeps every level."""


class StageFiles(NamedTuple):
    """What a page about a scene is made of beside what all of them share."""

    folder: Traversable  # where its files are
    template: str  # extends `stage.html.j2`
    scripts: tuple[str, ...]  # each needs those before it
    shaders: tuple[str, ...] = ()
    styles: tuple[str, ...] = ()


def write_stage(path: str | Path, files: StageFiles, values: Mapping[str, Any], **shown: Any) -> None:
    """Write a page about a scene; its programs are given `values`, its template what is `shown`."""
    folder = files.folder
    scripts = [asset(SHARED, name) for name in SCRIPTS] + [asset(folder, name) for name in files.scripts]
    shaders = {name: asset(SHARED, name) for name in SHADERS}
    shaders |= {name: asset(folder, name) for name in files.shaders}
    styles = [asset(SHARED, "stage.css"), *(asset(folder, name) for name in files.styles)]
    text = template(folder, files.template).render(
        scene_json=script_json(values),
        shaders_json=script_json(shaders),
        css="".join(styles),
        policy=content_policy(scripts),
        scripts=scripts,
        **shown,
    )
    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")


def disparity_codes(
    disparity: NDArray[np.floating], mask: NDArray[np.bool_], max_code: int = MAX_CODE
) -> tuple[NDArray[np.uint16], float, float]:
    """Return disparities as whole numbers, with the least one and the unit of the numbers from 1."""
    values = disparity[mask].astype(np.float64)
    lowest, highest = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    unit = (highest - lowest) / (max_code - 1) if highest > lowest else 1.0
    codes = np.zeros(disparity.shape, np.uint16)
    codes[mask] = 1 + np.rint((values - lowest) / unit).astype(np.uint16)
    return codes, lowest, unit


def pack_codes(codes: NDArray[np.uint16]) -> bytes:
    """Return codes as few bytes: differences along rows, high and low bytes apart, deflated."""
    differences = np.diff(codes, axis=1, prepend=np.uint16(0))
    planes = np.stack([differences >> 8, differences & 255]).astype(np.uint8)
    return zlib.compress(planes.tobytes(), 9)


def surface_values(
    disparity: NDArray[np.floating], mask: NDArray[np.bool_], picture: bytes | None, max_code: int = MAX_CODE
) -> dict[str, Any]:
    """Return a surface as the programs of a page read it; without a picture it has that of the page."""
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
    """Return a calibrated camera, [R | t] from the world to it, as the programs of a page read it."""
    return {
        "intrinsic": intrinsic.ravel().tolist(),
        "rotation": pose[:, :3].ravel().tolist(),
        "centre": (-pose[:, :3].T @ pose[:, 3]).tolist(),
    }


def palette_text() -> str:
    """Return red, green and blue from far to near, 256 of them."""
    colours = colour_disparity(np.linspace(0.0, 1.0, 256)[None], 0.0, 1.0)[0, :, ::-1]
    return base64_text(np.ascontiguousarray(colours).tobytes())


def webp(picture: NDArray[np.uint8], quality: int = LOSSLESS) -> bytes:
    """Return red, green and blue as a file."""
    _, coded = cv2.imencode(".webp", picture[:, :, ::-1], [cv2.IMWRITE_WEBP_QUALITY, quality])
    return coded.tobytes()


def base64_text(content: bytes) -> str:
    """Return bytes as text."""
    return base64.b64encode(content).decode("ascii")
