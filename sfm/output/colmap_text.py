"""Cameras and points as COLMAP's text files; COLMAP puts the centre of the first pixel at (0.5, 0.5)."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX

Floats = NDArray[np.float64]


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
