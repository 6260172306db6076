"""Files of maps for other programs: COLMAP's models, clouds of points, camera paths, depth maps."""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.arrays import Bytes, Floats, Mask, Singles
from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX

MAX_LEVEL = 2**16 - 1
PLY_HEADER = """\
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


def colmap_model(
    size: tuple[int, int],
    intrinsics: Floats,
    poses: Mapping[str, Floats],
    cloud: tuple[Floats, Bytes],
    tracks: Sequence[Floats] = (),
) -> Any:
    """Return COLMAP's model of one camera, pictures with poses by file name, and coloured points.

    `tracks` are the positions of all points in each picture; without them points have no track. COLMAP puts
    the centre of the first pixel at (0.5, 0.5); this function converts.
    """
    import pycolmap

    if intrinsics[0, 1] != 0.0:
        raise ValueError(f"`intrinsics` must have no skew, got {intrinsics[0, 1]}")
    (fx, fy), (cx, cy) = np.diag(intrinsics)[:2], intrinsics[:2, 2] + COLMAP_FIRST_PIXEL_PX
    kind, focal = ("SIMPLE_PINHOLE", [fx]) if fx == fy else ("PINHOLE", [fx, fy])
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(model=kind, width=size[0], height=size[1], params=[*focal, cx, cy], camera_id=1)
    )
    for number, (name, pose) in enumerate(poses.items()):
        keypoints = tracks[number] + COLMAP_FIRST_PIXEL_PX if tracks else np.empty((0, 2))
        image = pycolmap.Image(name=name, keypoints=keypoints, camera_id=1, image_id=number + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
    for index, (position, colour) in enumerate(zip(*cloud, strict=True)):
        elements = [pycolmap.TrackElement(number + 1, index) for number in range(len(tracks))]
        model.add_point3D(position, pycolmap.Track(elements), colour)
    model.update_point_3d_errors()
    return model


def write_ply(path: Path, points: Floats, colours: Bytes, comment: str) -> None:
    """Write points, shape (N, 3), in single precision, with red, green and blue, as a binary PLY file."""
    vertices = np.empty(len(points), [("position", "<f4", 3), ("colour", "u1", 3)])
    vertices["position"], vertices["colour"] = points, colours
    path.write_bytes(PLY_HEADER.format(comment=comment, count=len(points)).encode() + vertices.tobytes())


def write_trajectory(path: Path, poses: Mapping[int, Floats], fps: Fraction | float | None) -> None:
    """Write poses, world to camera, in the format of the TUM RGB-D benchmark: lines of camera to world.

    The time of a frame follows from its index.
    """
    from scipy.spatial.transform import Rotation

    unit = "frame index" if fps is None else f"seconds, frame index / {fps}"
    lines = ["# timestamp tx ty tz qx qy qz qw", f"# camera to world; timestamp: {unit}"]
    for number in sorted(poses):
        turn, shift = poses[number][:, :3].T, poses[number][:, 3]
        quaternion = Rotation.from_matrix(turn).as_quat(canonical=True)
        time = f"{number}" if fps is None else f"{float(number / Fraction(fps)):.6f}"
        lines.append(" ".join([time, *(f"{value:.9g}" for value in (*(-turn @ shift), *quaternion))]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def is_known(depth: Singles) -> Mask:
    """Return a mask of the pixels with a depth."""
    return np.isfinite(depth) & (depth > 0.0)


def depth_step(depths: Mapping[int, Singles]) -> float:
    """Return the depth of one level, so that the largest depth of all has the largest level."""
    largest = max((float(depth[is_known(depth)].max(initial=0.0)) for depth in depths.values()), default=0.0)
    return largest / MAX_LEVEL or 1.0


def depth_levels(depth: Singles, step: float) -> NDArray[np.uint16]:
    """Return depths as levels from 1; 0 is unknown."""
    known = is_known(depth)
    levels = np.zeros(depth.shape, np.uint16)
    levels[known] = np.clip(np.rint(depth[known].astype(np.float64) / step), 1, MAX_LEVEL).astype(np.uint16)
    return levels


def write_depth_maps(folder: Path, depths: Mapping[int, Singles], step: float) -> None:
    """Write ``000012.png`` for frame 12, and so on, with levels of 16 bits."""
    for number, depth in depths.items():
        _, coded = cv2.imencode(".png", depth_levels(depth, step))
        (folder / f"{number:06d}.png").write_bytes(coded.tobytes())
