"""Cameras and points as COLMAP's text files; COLMAP puts the centre of the first pixel at (0.5, 0.5)."""

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX

Floats = NDArray[np.float64]
Depths = NDArray[np.float32]

VERTEX = np.dtype([("position", "<f4", 3), ("colour", "u1", 3)])
_HEADER = """\
ply
format binary_little_endian 1.0
comment {comment}
element vertex {count}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
end_header
"""
MAX_LEVEL = 2**16 - 1


class ColmapImage(NamedTuple):
    """A picture that was taken by a known camera."""

    number: int  # from 1, unique
    name: str  # of its file
    pose: Floats  # [R | t], from the world to the camera
    points_px: Floats | None = None  # where it shows each point of the cloud


class ColmapCloud(NamedTuple):
    """Points; all images show all of them, or it is not told which do."""

    points: Floats  # shape (N, 3)
    colours: NDArray[np.uint8]  # red, green and blue
    error_px: float = 0.0  # of reprojection


def write_colmap_text(
    folder: Path,
    size: tuple[int, int],
    intrinsics: Floats,
    images: Sequence[ColmapImage],
    cloud: ColmapCloud,
) -> None:
    """Write ``cameras.txt``, ``images.txt`` and ``points3D.txt``; size is width and height."""
    _write_lines(
        folder / "cameras.txt",
        ["Camera list with one line of data per camera: CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"],
        [_camera_line(size, intrinsics)],
    )
    _write_lines(
        folder / "images.txt",
        [
            "Image list with two lines of data per image:",
            "  IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
            "  POINTS2D[] as (X, Y, POINT3D_ID)",
        ],
        (line for image in images for line in _image_lines(image)),
    )
    tracks = [(image.number, image.points_px is not None) for image in images]
    shown_by = [number for number, shows in tracks if shows]
    _write_lines(
        folder / "points3D.txt",
        ["3D point list: POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"],
        _point_lines(cloud, shown_by),
    )


def _camera_line(size: tuple[int, int], intrinsics: Floats) -> str:
    """Return a camera of square pixels as COLMAP's simplest one; the skew must be 0."""
    if intrinsics[0, 1] != 0.0:
        raise ValueError(f"`intrinsics` must have no skew, got {intrinsics[0, 1]}")
    (fx, fy), (cx, cy) = np.diag(intrinsics)[:2], intrinsics[:2, 2] + COLMAP_FIRST_PIXEL_PX
    focal = [fx] if fx == fy else [fx, fy]
    model = "SIMPLE_PINHOLE" if fx == fy else "PINHOLE"
    parameters = " ".join(f"{value:.12g}" for value in (*focal, cx, cy))
    return f"1 {model} {size[0]} {size[1]} {parameters}"


def _image_lines(image: ColmapImage) -> tuple[str, str]:
    pose = " ".join(f"{value:.12g}" for value in (*quaternion(image.pose[:, :3]), *image.pose[:, 3]))
    points = () if image.points_px is None else image.points_px + COLMAP_FIRST_PIXEL_PX
    shown = " ".join(f"{x:.6f} {y:.6f} {number}" for number, (x, y) in enumerate(points, 1))
    return f"{image.number} {pose} 1 {image.name}", shown


def _point_lines(cloud: ColmapCloud, shown_by: Sequence[int]) -> Iterable[str]:
    for index, ((x, y, z), (r, g, b)) in enumerate(zip(cloud.points, cloud.colours, strict=True)):
        track = "".join(f" {number} {index}" for number in shown_by)
        yield f"{index + 1} {x:.10g} {y:.10g} {z:.10g} {r} {g} {b} {cloud.error_px:.4f}{track}"


def _write_lines(path: Path, comments: Sequence[str], lines: Iterable[str]) -> None:
    with path.open("w", encoding="utf-8") as file:
        file.writelines(f"# {comment}\n" for comment in comments)
        file.writelines(f"{line}\n" for line in lines)


def quaternion(rotation: Floats) -> Floats:
    """Return a rotation as w, x, y, z with w not negative."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat(canonical=True)
    return np.array([w, x, y, z])


def write_ply(path: str | Path, points: Floats, colours: NDArray[np.uint8], comment: str) -> None:
    """Write points, shape (N, 3), in single precision, with red, green and blue; inverse of `read_ply`."""
    vertices = np.empty(len(points), VERTEX)
    vertices["position"], vertices["colour"] = points, colours
    with Path(path).open("wb") as file:
        file.write(_HEADER.format(comment=comment, count=len(points)).encode("ascii"))
        file.write(vertices.tobytes())


def read_ply(path: str | Path) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Read the points and colours of a file that `write_ply` has written."""
    header, _, body = Path(path).read_bytes().partition(b"end_header\n")
    if header.splitlines()[-6:] != _HEADER.encode("ascii").splitlines()[-7:-1]:
        raise ValueError(f"{path}: not a cloud of coloured points")
    vertices = np.frombuffer(body, VERTEX)
    return vertices["position"], vertices["colour"]


def write_trajectory(path: Path, poses: Mapping[int, Floats], fps: Fraction | float | None) -> None:
    """Write poses, world to camera, as lines of camera to world; a time is that of a frame by its number."""
    unit = "the number of the frame" if fps is None else f"seconds, the number of the frame / {fps}"
    lines = ["# timestamp tx ty tz qx qy qz qw", f"# camera to world; timestamp: {unit}"]
    for number in sorted(poses):
        turn, shift = poses[number][:, :3].T, poses[number][:, 3]
        w, x, y, z = quaternion(turn)
        time = f"{number}" if fps is None else f"{float(number / Fraction(fps)):.6f}"
        lines.append(" ".join([time, *(f"{value:.9g}" for value in (*(-turn @ shift), x, y, z, w))]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def depth_step(depths: Mapping[int, Depths]) -> float:
    """Return the depth of a level: the largest depth of all has the largest level."""
    largest = max((float(depth[is_known(depth)].max(initial=0.0)) for depth in depths.values()), default=0.0)
    return largest / MAX_LEVEL or 1.0


def is_known(depth: Depths) -> NDArray[np.bool_]:
    """Tell where there is a depth."""
    return np.isfinite(depth) & (depth > 0.0)


def depth_levels(depth: Depths, step: float) -> NDArray[np.uint16]:
    """Return depths as levels from 1; 0 is where none is known."""
    known = is_known(depth)
    levels = np.zeros(depth.shape, np.uint16)
    levels[known] = np.clip(np.rint(depth[known].astype(np.float64) / step), 1, MAX_LEVEL).astype(np.uint16)
    return levels


def write_depth_maps(folder: Path, depths: Mapping[int, Depths], step: float) -> None:
    """Write ``000012.png`` for frame 12, and so on."""
    for number, depth in depths.items():
        _, coded = cv2.imencode(".png", depth_levels(depth, step))
        (folder / f"{number:06d}.png").write_bytes(coded.tobytes())
