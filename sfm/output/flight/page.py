"""The page of a map: one file, which loads nothing."""

from collections.abc import Callable
from fractions import Fraction
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from dvc.video import Frame
from dvc.video.pixels import rgb_from_frame
from dvc.web.document import data_uri
from dvc.web.surfaces import StageFiles, palette_text, webp, write_stage
from sfm.mapping.scene_map import SceneMap
from sfm.output.flight.contents import (
    MAX_SMALL_SIDE_PX,
    SMALL_QUALITY,
    Shares,
    piece_values,
    resized,
    shown_size,
)

FILES = StageFiles(
    resources.files("sfm.output.flight") / "templates",
    "flight.html.j2",
    scripts=("orbit.js", "overlay.js", "sources.js", "film.js", "flight.js"),
    shaders=("world.vert", "world.frag"),
    styles=("flight.css",),
)
SAME_SURFACE = 1.06
"""Inverse depths of neighbours on one surface have at most this ratio."""


def write_flight(
    path: Path, scene: SceneMap, frame: Callable[[int], Frame], fps: Fraction | float | None, title: str
) -> None:
    """Write the page."""
    still = _still(scene, frame)
    values = flight_values(scene, frame, fps, title)
    write_stage(
        path,
        FILES,
        values,
        title=title,
        width=values["width"],
        height=values["height"],
        still=still,
        summary=scene.summary,
        pieces=values["pieces"],
    )


def flight_values(
    scene: SceneMap, frame: Callable[[int], Frame], fps: Fraction | float | None, title: str
) -> dict[str, Any]:
    """Return what the programs of the page are told."""
    size = scene.width_px, scene.height_px
    width, height = shown_size(size)
    located = [piece for piece in scene.pieces if piece.poses]
    shares = Shares.of(max(1, len(located)))
    return {
        "name": title,
        "width": width,
        "height": height,
        "num_frames": scene.num_frames,
        "frames_per_second": None if fps is None else float(fps),
        "ratio": SAME_SURFACE,
        "palette": palette_text(),
        "pieces": [piece_values(piece, frame, size, shares) for piece in located],
    }


def _still(scene: SceneMap, frame: Callable[[int], Frame]) -> str:
    """Address of the first picture, which is shown where nothing can be drawn."""
    picture = np.zeros((1, 1, 3), np.uint8)
    if scene.num_frames:
        picture = rgb_from_frame(frame(0))
    small = resized(picture, shown_size((picture.shape[1], picture.shape[0]), MAX_SMALL_SIDE_PX))
    return data_uri("image/webp", webp(small, SMALL_QUALITY))
