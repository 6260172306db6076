"""The page of a map: one file, which loads nothing."""

import zlib
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.video import Frame
from dvc.video.pixels import rgb_from_frame
from dvc.web.document import data_uri
from dvc.web.surfaces import (
    StageFiles,
    camera_values,
    disparity_codes,
    palette_text,
    surface_values,
    text_of,
    webp,
    write_stage,
)
from sfm.mapping.scene_map import MapPiece, SceneMap
from sfm.output.map_files import is_known

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]

FILES = StageFiles(
    resources.files("sfm.output") / "templates",
    "flight.html.j2",
    scripts=("orbit.js", "overlay.js", "sources.js", "film.js", "flight.js"),
    shaders=("world.vert", "world.frag"),
    styles=("flight.css",),
)
SAME_SURFACE = 1.06
"""Inverse depths of neighbours on one surface have at most this ratio."""
MAX_SIDE_PX = 960
"""Larger frames are shown smaller."""
MAX_SMALL_SIDE_PX = 480
"""The same for frames without depth, which are shown beside the scene."""
MAX_POINTS = 300_000
MAX_SOURCES = 64
MAX_PICTURES = 600
SOURCE_BYTES, PICTURE_BYTES = 12_000_000, 5_000_000
"""Of all pictures with depth, and of all others, as text."""
QUALITY, SMALL_QUALITY = 90, 75
MAX_CODE = 2**12 - 1
"""Inverse depths have as many levels: an error of less than a tenth of a pixel between usual cameras."""
STRAY = 3.0
"""Inverse depths so many times as large as those of nearly all pixels are errors."""
FAR_SHARE = 0.002
"""Share of points on either side of each axis that does not decide which part of the cloud is shown."""
MOST = 0.75
"""Share of the points that are in the view."""
CAMERAS = 0.3
"""Weight of the cameras in the middle."""
AHEAD = 10.0
"""Distance that is looked at where nothing is known, in lengths of the path or units."""
Item = TypeVar("Item")


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


class Shares(NamedTuple):
    """What a piece may take of a page."""

    source_bytes: int  # of pictures with depth, and of others
    picture_bytes: int
    num_points: int

    @classmethod
    def of(cls, num_pieces: int) -> "Shares":
        """Return equal shares."""
        return cls(SOURCE_BYTES // num_pieces, PICTURE_BYTES // num_pieces, MAX_POINTS // num_pieces)


def shown_size(size: tuple[int, int], max_side: int = MAX_SIDE_PX) -> tuple[int, int]:
    """Return width and height within a longest side."""
    scale = min(1.0, max_side / max(size))
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))


def scaled_intrinsics(intrinsics: Floats, size: tuple[int, int], shown: tuple[int, int]) -> Floats:
    """Return the camera of a picture that was resized; the centre of its first pixel is at (0, 0) again."""
    ratio = np.array([shown[0] / size[0], shown[1] / size[1], 1.0])
    middle = np.array([0.5, 0.5, 0.0])
    scaled: Floats = intrinsics * ratio[:, None]
    scaled[:, 2] += (ratio - 1.0) * middle
    return scaled


def resized(picture: Picture, shown: tuple[int, int]) -> Picture:
    """Return a picture of another size."""
    if picture.shape[1::-1] == shown:
        return picture
    return np.asarray(cv2.resize(picture, shown, interpolation=cv2.INTER_AREA), np.uint8)


def piece_values(
    piece: MapPiece, frame: Callable[[int], Frame], size: tuple[int, int], shares: Shares
) -> dict[str, Any]:
    """Return what the programs of the page are told of a piece."""
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
        "rotations": [_digits(camera["rotation"]) for camera in cameras.values()],
        "centres": [_digits(camera["centre"]) for camera in cameras.values()],
        "sources": sources.items,
        "pictures": pictures.items,
        "cloud": cloud_values(piece.points, piece.colours, shares.num_points),
        "overview": overview(piece),
    }


def _digits(values: list[float]) -> list[float]:
    return [float(f"{value:.9g}") for value in values]


def _picture_values(number: int, frame: Callable[[int], Frame]) -> dict[str, Any]:
    picture = rgb_from_frame(frame(number))
    small = resized(picture, shown_size(picture.shape[1::-1], MAX_SMALL_SIDE_PX))
    return {"frame": number, "picture": text_of(webp(small, SMALL_QUALITY))}


def _source_values(
    number: int, depth: NDArray[np.float32], frame: Callable[[int], Frame], camera: dict[str, Any]
) -> dict[str, Any]:
    near, mask = nearness(depth)
    shown = shown_size(depth.shape[::-1])
    if shown != depth.shape[::-1]:
        near = np.asarray(cv2.resize(near, shown, interpolation=cv2.INTER_NEAREST_EXACT), np.float32)
        mask = cv2.resize(mask.astype(np.uint8), shown, interpolation=cv2.INTER_NEAREST_EXACT) > 0
    picture = webp(resized(rgb_from_frame(frame(number)), shown), QUALITY)
    values = surface_values(near, mask, picture, MAX_CODE)
    nearest = float(near[mask].max(initial=0.0))
    return {"frame": number, "position": None, "camera": camera, "pieces": [values], "nearest": nearest}


def nearness(depth: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return inverse depths, and where they are known and no strays."""
    known = is_known(depth)
    near = np.zeros(depth.shape, np.float32)
    near[known] = 1.0 / depth[known]
    if known.any():
        known &= near <= STRAY * np.quantile(near[known], 0.99)
    return near, known


def cloud_values(points: Floats, colours: Picture, max_points: int) -> dict[str, Any]:
    """Return points of the part where nearly all of them are, in 16 bits of its sides."""
    kept = np.flatnonzero(np.isfinite(points).all(axis=1))
    if kept.size:
        low, high = np.quantile(points[kept], [FAR_SHARE, 1.0 - FAR_SHARE], axis=0)
        low, high = low - 0.5 * (high - low), high + 0.5 * (high - low)
        kept = kept[((points[kept] >= low) & (points[kept] <= high)).all(axis=1)]
    if kept.size > max_points:
        kept = np.sort(np.random.default_rng(0).permutation(kept)[:max_points])
    axes, mask = points[kept].T, np.ones(kept.size, np.bool_)
    codes, lows, units = zip(*(disparity_codes(axis, mask) for axis in axes), strict=True)
    planes = [plane for code in codes for plane in (code >> 8, code & 255)]
    stored = np.stack([*planes, *colours[kept].T]).astype(np.uint8)
    return {
        "count": int(kept.size),
        "low": lows,
        "unit": units,
        "codes": text_of(zlib.compress(stored.tobytes(), 9)),
        "spacing": _spacing(points[kept]),
    }


def _spacing(points: Floats) -> float:
    """Return the usual distance of a point to its second neighbour."""
    from scipy.spatial import KDTree

    if len(points) < 3:
        return 0.0
    some = np.random.default_rng(0).choice(len(points), min(len(points), 1000), replace=False)
    distances, _ = KDTree(points).query(points[some], k=3)
    return float(np.median(distances[:, 2]))


def _source_size(source: dict[str, Any]) -> int:
    return sum(len(part["codes"]) + len(part["picture"]) for part in source["pieces"])


def _picture_size(picture: dict[str, Any]) -> int:
    return len(picture["picture"])


def overview(piece: MapPiece) -> dict[str, Any]:
    """Return what is up and ahead, the middle of the scene, and within which radius of it nearly all is."""
    poses = np.array([piece.poses[number] for number in sorted(piece.poses)])
    centres = -np.einsum("kji,kj->ki", poses[:, :, :3], poses[:, :, 3])
    up, ahead = _unit(-poses[:, 1, :3].mean(axis=0)), _unit(poses[:, 2, :3].mean(axis=0))
    path = float(np.linalg.norm(np.ptp(centres, axis=0)))
    points = piece.points[np.isfinite(piece.points).all(axis=1)]
    if len(points) == 0:
        points = centres + AHEAD * (path or 1.0) * poses[:, 2, :3]
    middle = (1.0 - CAMERAS) * np.median(points, axis=0) + CAMERAS * centres.mean(axis=0)
    away = np.linalg.norm(points - middle, axis=1)
    to_cameras = float(np.linalg.norm(centres - middle, axis=1).max())
    return {
        "up": up.tolist(),
        "ahead": ahead.tolist(),
        "middle": middle.tolist(),
        "radius": max(float(np.quantile(away, MOST)), to_cameras, 1e-9),
        "path": path,
        "depth": max(float(np.median((points - centres.mean(axis=0)) @ ahead)), 0.05 * to_cameras, 1e-9),
    }


def _unit(vector: Floats) -> Floats:
    """Return a direction; any where there is none."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])


class Thinned(Generic[Item]):
    """Keeps every item of a series, then every second one, and so on, so that they stay within a size."""

    def __init__(self, max_size: int, max_items: int, size_of: Callable[[Item], int]) -> None:
        self._max_size, self._max_items, self._size_of = max_size, max_items, size_of
        self._stride, self._count = 1, 0
        self.items: list[Item] = []

    def offer(self, make: Callable[[], Item]) -> None:
        """Make the next item of the series and keep it, unless it is left out as others are."""
        if self._count % self._stride == 0:
            self.items.append(make())
            while len(self.items) > 1 and self._is_too_much():
                self.items = self.items[::2]
                self._stride *= 2
        self._count += 1

    def _is_too_much(self) -> bool:
        size = sum(self._size_of(item) for item in self.items)
        return len(self.items) > self._max_items or size > self._max_size
