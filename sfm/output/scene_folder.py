"""The map of a sequence as a folder: files for other programs, and a page that loads nothing else.

The page shows a flight along the camera's path, or a free view.
"""

import zlib
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dvc.arrays import Bytes, Floats, Mask, Singles
from dvc.errors import ConfigError
from dvc.files import atomic_folder
from dvc.video import Frame, open_video
from dvc.video.pixels import rgb_from_frame
from dvc.video.readers import FrameLookup
from dvc.web.document import data_uri
from dvc.web.surfaces import (
    StageFiles,
    base64_text,
    camera_values,
    disparity_codes,
    palette_text,
    surface_values,
    webp,
    write_stage,
)
from sfm.mapping.scene_map import MapPiece, SceneMap
from sfm.output import map_files

MAX_SPARSE_POINTS = 100_000
"""Largest number of points in COLMAP's text files, which programs read slowly."""
UNIT = "the unit of length is arbitrary, one for each piece"
FILES = StageFiles(
    resources.files("sfm.output") / "templates",
    "flight.html.j2",
    scripts=("orbit.js", "overlay.js", "sources.js", "film.js", "flight.js"),
    shaders=("world.vert", "world.frag"),
    styles=("flight.css",),
)
SAME_SURFACE = 1.06
"""Largest ratio of the inverse depths of neighbours on one surface."""
MAX_SIDE_PX = 960
"""Longest side of frames on the page; larger frames are reduced."""
MAX_SMALL_SIDE_PX = 480
"""Longest side of frames without depth, which are shown next to the scene."""
MAX_POINTS = 300_000
MAX_SOURCES = 64
MAX_PICTURES = 600
SOURCE_BYTES, PICTURE_BYTES = 12_000_000, 5_000_000
"""Largest sizes, as text, of all pictures with depth, and of all other pictures."""
QUALITY, SMALL_QUALITY = 90, 75
MAX_CODE = 2**12 - 1
"""Number of levels of inverse depths: an error below a tenth of a pixel between usual cameras."""
STRAY = 3.0
"""Largest inverse depth of valid pixels, in units of the quantile of nearly all pixels."""
FAR_SHARE = 0.002
"""Share of points on either side of each axis that does not influence the visible part of the cloud."""
VISIBLE_SHARE = 0.75
"""Share of the points within the overview."""
CAMERA_WEIGHT = 0.3
"""Weight of the cameras in the middle of the overview."""
AHEAD = 10.0
"""Distance of the overview without points, in lengths of the path or units."""


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
    target, size, pieces = Path(folder), (scene.width_px, scene.height_px), []
    for number, piece in enumerate(scene.pieces):
        name = f"piece-{number}" if number else "."
        part = target / name
        part.mkdir(exist_ok=True)
        poses = {f"{n:06d}.png": piece.poses[n] for n in sorted(piece.poses)}
        count = min(len(piece.points), MAX_SPARSE_POINTS)
        chosen = np.linspace(0, len(piece.points) - 1, count).astype(np.int64)
        cloud = piece.points[chosen], piece.colours[chosen]
        (part / "sparse").mkdir()
        map_files.colmap_model(size, piece.intrinsics, poses, cloud).write_text(part / "sparse")
        map_files.write_trajectory(part / "trajectory.txt", piece.poses, fps)
        matrix = piece.intrinsics.tolist()
        intrinsics = {"size": list(size), "matrix": matrix, "centre_of_first_pixel": [0, 0]}
        map_files.write_json(part / "intrinsics.json", intrinsics)
        map_files.write_ply(part / "points.ply", piece.points, piece.colours, UNIT)
        step, depth_frames = map_files.depth_step(piece.depths), sorted(piece.depths)
        (part / "depth").mkdir()
        map_files.write_depth_maps(part / "depth", piece.depths, step)
        depth = {"depth_of_a_level": step, "unknown": 0, "frames": depth_frames}
        map_files.write_json(part / "depth.json", depth)
        entry = {
            "folder": name,
            "frames": sorted(piece.poses),
            "num_points": len(piece.points),
            "depth_frames": depth_frames,
            "files": ["sparse", "trajectory.txt", "intrinsics.json", "points.ply", "depth", "depth.json"],
        }
        pieces.append(entry)
    write_flight(target / "index.html", scene, frame, fps, title)
    values = {
        "summary": scene.summary,
        "size": list(size),
        "num_frames": scene.num_frames,
        "num_located": scene.num_located,
        "frames_per_second": None if fps is None else float(fps),
        "unit": UNIT,
        "page": "index.html",
        "pieces": pieces,
    }
    map_files.write_json(target / "scene.json", values)


def write_flight(
    path: Path, scene: SceneMap, frame: Callable[[int], Frame], fps: Fraction | float | None, title: str
) -> None:
    """Write the page."""
    still = rgb_from_frame(frame(0)) if scene.num_frames else np.zeros((1, 1, 3), np.uint8)
    size = scene.width_px, scene.height_px
    width, height = shown_size(size)
    located = [piece for piece in scene.pieces if piece.poses]
    values = {
        "name": title,
        "width": width,
        "height": height,
        "num_frames": scene.num_frames,
        "frames_per_second": None if fps is None else float(fps),
        "ratio": SAME_SURFACE,
        "palette": palette_text(),
        "pieces": [piece_values(piece, frame, size, len(located)) for piece in located],
    }
    shown = {"title": title, "width": width, "height": height, "summary": scene.summary}
    image = data_uri("image/webp", _small_webp(still))
    write_stage(path, FILES, values, **shown, still=image, pieces=values["pieces"])


class Thinned:
    """Every item of a series, then every second one, and so on, within limits of size and number."""

    def __init__(self, max_size: int, max_items: int, size_of: Callable[[Any], int]) -> None:
        self._max_size, self._max_items, self._size_of = max_size, max_items, size_of
        self._stride, self._count = 1, 0
        self.items: list[Any] = []

    def offer(self, make: Callable[[], Any]) -> None:
        """Make and keep the next item of the series, unless the stride skips it."""
        if self._count % self._stride == 0:
            self.items.append(make())
            while len(self.items) > 1 and (
                len(self.items) > self._max_items or sum(map(self._size_of, self.items)) > self._max_size
            ):
                self.items, self._stride = self.items[::2], 2 * self._stride
        self._count += 1


def piece_values(
    piece: MapPiece, frame: Callable[[int], Frame], size: tuple[int, int], num_pieces: int
) -> dict[str, Any]:
    """Return the data of one of several pieces: cameras, pictures, pictures with depth, points, overview."""

    def source_size(source: dict[str, Any]) -> int:
        return sum(len(part["codes"]) + len(part["picture"]) for part in source["pieces"])

    numbers = sorted(piece.poses)
    intrinsics = scaled_intrinsics(piece.intrinsics, size, shown_size(size))
    cameras = {number: camera_values(intrinsics, piece.poses[number]) for number in numbers}
    sources = Thinned(SOURCE_BYTES // num_pieces, MAX_SOURCES, source_size)
    pictures = Thinned(PICTURE_BYTES // num_pieces, MAX_PICTURES, lambda item: len(item["picture"]))
    for k in numbers:
        if k in piece.depths:
            sources.offer(partial(_source_values, k, piece.depths[k], frame, cameras[k]))
        pictures.offer(partial(_picture_values, k, frame))
    return {
        "intrinsic": intrinsics.ravel().tolist(),
        "frames": numbers,
        "rotations": [_rounded(camera["rotation"]) for camera in cameras.values()],
        "centres": [_rounded(camera["centre"]) for camera in cameras.values()],
        "sources": sources.items,
        "pictures": pictures.items,
        "cloud": cloud_values(piece.points, piece.colours, MAX_POINTS // num_pieces),
        "overview": overview(piece),
    }


def _rounded(values: list[float]) -> list[float]:
    return [float(f"{value:.9g}") for value in values]


def shown_size(size: tuple[int, int], max_side: int = MAX_SIDE_PX) -> tuple[int, int]:
    """Return width and height within a longest side."""
    scale = min(1.0, max_side / max(size))
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))


def scaled_intrinsics(intrinsics: Floats, size: tuple[int, int], shown: tuple[int, int]) -> Floats:
    """Return the camera of a resized picture; the centre of its first pixel is at (0, 0) again."""
    ratio = np.array([shown[0] / size[0], shown[1] / size[1], 1.0])
    scaled: Floats = intrinsics * ratio[:, None]
    scaled[:, 2] += (ratio - 1.0) * np.array([0.5, 0.5, 0.0])
    return scaled


def resized(picture: Bytes, shown: tuple[int, int]) -> Bytes:
    """Return a picture in another size."""
    if picture.shape[1::-1] == shown:
        return picture
    return np.asarray(cv2.resize(picture, shown, interpolation=cv2.INTER_AREA), np.uint8)


def _small_webp(picture: Bytes) -> bytes:
    size = picture.shape[1], picture.shape[0]
    return webp(resized(picture, shown_size(size, MAX_SMALL_SIDE_PX)), SMALL_QUALITY)


def _picture_values(number: int, frame: Callable[[int], Frame]) -> dict[str, Any]:
    return {"frame": number, "picture": base64_text(_small_webp(rgb_from_frame(frame(number))))}


def _source_values(
    number: int, depth: Singles, frame: Callable[[int], Frame], camera: dict[str, Any]
) -> dict[str, Any]:
    near, mask = nearness(depth)
    shown = shown_size((depth.shape[1], depth.shape[0]))
    if shown != depth.shape[::-1]:
        near = np.asarray(cv2.resize(near, shown, interpolation=cv2.INTER_NEAREST_EXACT), np.float32)
        mask = cv2.resize(mask.astype(np.uint8), shown, interpolation=cv2.INTER_NEAREST_EXACT) > 0
    picture = webp(resized(rgb_from_frame(frame(number)), shown), QUALITY)
    values = surface_values(near, mask, picture, MAX_CODE)
    nearest = float(near[mask].max(initial=0.0))
    return {"frame": number, "position": None, "camera": camera, "pieces": [values], "nearest": nearest}


def nearness(depth: Singles) -> tuple[Singles, Mask]:
    """Return inverse depths, and a mask of those that are known and no strays."""
    known = map_files.is_known(depth)
    near = np.zeros(depth.shape, np.float32)
    near[known] = 1.0 / depth[known]
    if known.any():
        known &= near <= STRAY * np.quantile(near[known], 0.99)
    return near, known


def cloud_values(points: Floats, colours: Bytes, max_points: int) -> dict[str, Any]:
    """Return the points of the densest part, in 16 bits along each of its sides."""
    from scipy.spatial import KDTree

    chosen = np.flatnonzero(np.isfinite(points).all(axis=1))
    if chosen.size:
        low, high = np.quantile(points[chosen], [FAR_SHARE, 1.0 - FAR_SHARE], axis=0)
        low, high = low - 0.5 * (high - low), high + 0.5 * (high - low)
        chosen = chosen[((points[chosen] >= low) & (points[chosen] <= high)).all(axis=1)]
    if chosen.size > max_points:
        chosen = np.sort(np.random.default_rng(0).permutation(chosen)[:max_points])
    points, spacing = points[chosen], 0.0
    if len(points) >= 3:  # median distance of a point to its second neighbour
        some = np.random.default_rng(0).choice(len(points), min(len(points), 1000), replace=False)
        spacing = float(np.median(KDTree(points).query(points[some], k=3)[0][:, 2]))
    mask = np.ones(chosen.size, np.bool_)
    codes, lows, units = zip(*(disparity_codes(axis, mask) for axis in points.T), strict=True)
    planes = [plane for code in codes for plane in (code >> 8, code & 255)]
    stored = np.stack([*planes, *colours[chosen].T]).astype(np.uint8)
    return {
        "count": int(chosen.size),
        "low": lows,
        "unit": units,
        "codes": base64_text(zlib.compress(stored.tobytes(), 9)),
        "spacing": spacing,
    }


def overview(piece: MapPiece) -> dict[str, Any]:
    """Return directions up and ahead, and the middle and radius of the part of the scene to overlook."""
    poses = np.array([piece.poses[number] for number in sorted(piece.poses)])
    centres = -np.einsum("kji,kj->ki", poses[:, :, :3], poses[:, :, 3])
    up, ahead = _unit(-poses[:, 1, :3].mean(axis=0)), _unit(poses[:, 2, :3].mean(axis=0))
    path = float(np.linalg.norm(np.ptp(centres, axis=0)))
    points = piece.points[np.isfinite(piece.points).all(axis=1)]
    if len(points) == 0:
        points = centres + AHEAD * (path or 1.0) * poses[:, 2, :3]
    middle = (1.0 - CAMERA_WEIGHT) * np.median(points, axis=0) + CAMERA_WEIGHT * centres.mean(axis=0)
    away = np.linalg.norm(points - middle, axis=1)
    to_cameras = float(np.linalg.norm(centres - middle, axis=1).max())
    return {
        "up": up.tolist(),
        "ahead": ahead.tolist(),
        "middle": middle.tolist(),
        "radius": max(float(np.quantile(away, VISIBLE_SHARE)), to_cameras, 1e-9),
        "path": path,
        "depth": max(float(np.median((points - centres.mean(axis=0)) @ ahead)), 0.05 * to_cameras, 1e-9),
    }


def _unit(vector: Floats) -> Floats:
    """Return the direction of a vector; the z axis for a vector of zeros."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
