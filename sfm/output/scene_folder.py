"""The map of a sequence as a folder: files for other programs, and a page to look at."""

import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from dvc.errors import ConfigError
from dvc.files import atomic_folder
from dvc.video import Frame, open_video
from dvc.video.readers import FrameLookup
from sfm.mapping.scene_map import MapPiece, SceneMap

MAX_SPARSE_POINTS = 100_000
"""Largest number of points in COLMAP's text files, which programs read slowly."""
UNIT = "the unit of length is arbitrary, one for each piece"


def map_to_folder(
    path: str, folder: str | Path, mapper: str, report: Callable[[str], None] | None = None
) -> SceneMap:
    """Map a video, which must be readable several times, and write the map into a folder."""
    from sfm.mapping.map_sequence import map_video

    with open_video(path) as reader:
        info = reader.info
    if info.live:
        raise ConfigError(f"{path} can be read only once: a map needs a file or a folder")
    scene = map_video(path, mapper=mapper, report=report)
    with atomic_folder(folder) as target, FrameLookup(path) as frame:
        write_scene(target, scene, frame, info.frame_rate, Path(path).name)
    return scene


def write_scene(
    folder: str | Path,
    scene: SceneMap,
    frame: Callable[[int], Frame],
    fps: Fraction | float | None = None,
    title: str = "Map",
) -> None:
    """Write the map of a sequence into a folder, with a page that shows it.

    The first piece is in the folder itself, the other pieces are in ``piece-1``, ``piece-2`` and so on.
    docs/scene.md describes the files.

    Parameters
    ----------
    folder : str or Path
        An empty folder.
    scene : SceneMap
        The map.
    frame : callable
        Returns a frame by its index; called in rising order, for one frame at a time.
    fps : Fraction or float, optional
        Frames per second; without it times are frame indices.
    title : str, optional
        Heading of the page.

    Raises
    ------
    ValueError
        If a camera has skew.
    """
    from sfm.output.flight_page import write_flight

    target = Path(folder)
    pieces = []
    for number, piece in enumerate(scene.pieces):
        name = f"piece-{number}" if number else "."
        (target / name).mkdir(exist_ok=True)
        pieces.append({"folder": name, **_write_piece(target / name, piece, scene, fps)})
    write_flight(target / "index.html", scene, frame, fps, title)
    values = {
        "summary": scene.summary,
        "size": [scene.width_px, scene.height_px],
        "num_frames": scene.num_frames,
        "num_located": scene.num_located,
        "frames_per_second": None if fps is None else float(fps),
        "unit": UNIT,
        "page": "index.html",
        "pieces": pieces,
    }
    _write_json(target / "scene.json", values)


def _write_piece(
    folder: Path, piece: MapPiece, scene: SceneMap, fps: Fraction | float | None
) -> dict[str, Any]:
    """Write the files of a piece, and return its entry in the index."""
    from sfm.output.map_files import colmap_model, depth_step, write_depth_maps, write_ply, write_trajectory

    size = scene.width_px, scene.height_px
    poses = {f"{n:06d}.png": piece.poses[n] for n in sorted(piece.poses)}
    count = min(len(piece.points), MAX_SPARSE_POINTS)
    chosen = np.linspace(0, len(piece.points) - 1, count).astype(np.int64)
    cloud = piece.points[chosen], piece.colours[chosen]
    (folder / "sparse").mkdir()
    colmap_model(size, piece.intrinsics, poses, cloud).write_text(folder / "sparse")
    write_trajectory(folder / "trajectory.txt", piece.poses, fps)
    intrinsics = {"size": list(size), "matrix": piece.intrinsics.tolist(), "centre_of_first_pixel": [0, 0]}
    _write_json(folder / "intrinsics.json", intrinsics)
    write_ply(folder / "points.ply", piece.points, piece.colours, UNIT)
    step = depth_step(piece.depths)
    (folder / "depth").mkdir()
    write_depth_maps(folder / "depth", piece.depths, step)
    _write_json(
        folder / "depth.json", {"depth_of_a_level": step, "unknown": 0, "frames": sorted(piece.depths)}
    )
    return {
        "frames": sorted(piece.poses),
        "num_points": len(piece.points),
        "depth_frames": sorted(piece.depths),
        "files": ["sparse", "trajectory.txt", "intrinsics.json", "points.ply", "depth", "depth.json"],
    }


def _write_json(path: Path, values: object) -> None:
    path.write_text(json.dumps(values, indent=1, allow_nan=False) + "\n", encoding="utf-8")
