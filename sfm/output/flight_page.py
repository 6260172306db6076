"""The page of a map, one file that loads nothing: a flight along the camera's path, or a free view."""

import zlib
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import cv2
import numpy as np

from dvc.arrays import Bytes, Floats, Mask, Singles
from dvc.video import Frame
from dvc.video.pixels import rgb_from_frame
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
from sfm.output.map_files import is_known

Item = TypeVar("Item")

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


def write_flight(
    path: Path, scene: SceneMap, frame: Callable[[int], Frame], fps: Fraction | float | None, title: str
) -> None:
    """Write the page."""
    still = np.zeros((1, 1, 3), np.uint8)
    if scene.num_frames:
        still = rgb_from_frame(frame(0))
    values = flight_values(scene, frame, fps, title)
    write_stage(
        path,
        FILES,
        values,
        title=title,
        width=values["width"],
        height=values["height"],
        still=data_uri("image/webp", _small_webp(still)),
        summary=scene.summary,
        pieces=values["pieces"],
    )


def flight_values(
    scene: SceneMap, frame: Callable[[int], Frame], fps: Fraction | float | None, title: str
) -> dict[str, Any]:
    """Return the data for the scripts of the page."""
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


class Shares(NamedTuple):
    """Limits of one piece of a map."""

    source_bytes: int
    picture_bytes: int
    num_points: int

    @classmethod
    def of(cls, num_pieces: int) -> "Shares":
        """Return equal shares of the page."""
        return cls(SOURCE_BYTES // num_pieces, PICTURE_BYTES // num_pieces, MAX_POINTS // num_pieces)


class Thinned(Generic[Item]):
    """Every item of a series, then every second one, and so on, within limits of size and number."""

    def __init__(self, max_size: int, max_items: int, size_of: Callable[[Item], int]) -> None:
        self._max_size, self._max_items, self._size_of = max_size, max_items, size_of
        self._stride, self._count = 1, 0
        self.items: list[Item] = []

    def offer(self, make: Callable[[], Item]) -> None:
        """Make and keep the next item of the series, unless the stride skips it."""
        if self._count % self._stride == 0:
            self.items.append(make())
            while len(self.items) > 1 and self._exceeds_limits():
                self.items = self.items[::2]
                self._stride *= 2
        self._count += 1

    def _exceeds_limits(self) -> bool:
        size = sum(self._size_of(item) for item in self.items)
        return len(self.items) > self._max_items or size > self._max_size


def piece_values(
    piece: MapPiece, frame: Callable[[int], Frame], size: tuple[int, int], shares: Shares
) -> dict[str, Any]:
    """Return the data of a piece: its cameras, pictures, pictures with depth, points and overview."""
    numbers = sorted(piece.poses)
    intrinsics = scaled_intrinsics(piece.intrinsics, size, shown_size(size))
    cameras = {number: camera_values(intrinsics, piece.poses[number]) for number in numbers}
    sources: Thinned[dict[str, Any]] = Thinned(shares.source_bytes, MAX_SOURCES, _source_size)
    pictures: Thinned[dict[str, Any]] = Thinned(shares.picture_bytes, MAX_PICTURES, _picture_size)
    for number in numbers:
        if number in piece.depths:
            sources.offer(partial(_source_values, number, piece.depths[number], frame, cameras[number]))
        pictures.offer(partial(_picture_values, number, frame))
    return {
        "intrinsic": intrinsics.ravel().tolist(),
        "frames": numbers,
        "rotations": [_rounded(camera["rotation"]) for camera in cameras.values()],
        "centres": [_rounded(camera["centre"]) for camera in cameras.values()],
        "sources": sources.items,
        "pictures": pictures.items,
        "cloud": cloud_values(piece.points, piece.colours, shares.num_points),
        "overview": overview(piece),
    }


def _source_size(source: dict[str, Any]) -> int:
    return sum(len(part["codes"]) + len(part["picture"]) for part in source["pieces"])


def _picture_size(picture: dict[str, Any]) -> int:
    return len(picture["picture"])


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
    known = is_known(depth)
    near = np.zeros(depth.shape, np.float32)
    near[known] = 1.0 / depth[known]
    if known.any():
        known &= near <= STRAY * np.quantile(near[known], 0.99)
    return near, known


def cloud_values(points: Floats, colours: Bytes, max_points: int) -> dict[str, Any]:
    """Return the points of the densest part, in 16 bits along each of its sides."""
    chosen = np.flatnonzero(np.isfinite(points).all(axis=1))
    if chosen.size:
        low, high = np.quantile(points[chosen], [FAR_SHARE, 1.0 - FAR_SHARE], axis=0)
        low, high = low - 0.5 * (high - low), high + 0.5 * (high - low)
        chosen = chosen[((points[chosen] >= low) & (points[chosen] <= high)).all(axis=1)]
    if chosen.size > max_points:
        chosen = np.sort(np.random.default_rng(0).permutation(chosen)[:max_points])
    axes, mask = points[chosen].T, np.ones(chosen.size, np.bool_)
    codes, lows, units = zip(*(disparity_codes(axis, mask) for axis in axes), strict=True)
    planes = [plane for code in codes for plane in (code >> 8, code & 255)]
    stored = np.stack([*planes, *colours[chosen].T]).astype(np.uint8)
    return {
        "count": int(chosen.size),
        "low": lows,
        "unit": units,
        "codes": base64_text(zlib.compress(stored.tobytes(), 9)),
        "spacing": _spacing(points[chosen]),
    }


def _spacing(points: Floats) -> float:
    """Return the median distance of a point to its second neighbour."""
    from scipy.spatial import KDTree

    if len(points) < 3:
        return 0.0
    some = np.random.default_rng(0).choice(len(points), min(len(points), 1000), replace=False)
    distances, _ = KDTree(points).query(points[some], k=3)
    return float(np.median(distances[:, 2]))


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
