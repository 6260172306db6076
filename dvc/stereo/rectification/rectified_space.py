"""Rectified space of a planar array: homographies of pictures and of space, and resampling of pictures.

Equations (2.4) to (2.12), with ``V = (v1 v2 s n)``: the third vector is normal to the plane of the cameras,
as long as the square root of a cell's area, so that pixels keep their size in any unit of the world.

Two frames differ by a translation. In that of the equations, pixels are centred on the foot
of the normal, and disparity 0 is at infinity. In that of the pictures, one offset is added to (x, y) and one
number is subtracted from all disparities, by shifting picture (m, n) by m and n times as many pixels; other
changes would violate (2.5).

Pictures of cameras a little off the plane are scaled about the foot of the normal, so that (2.5)
holds at the middle disparity of the scene; in the plane, this changes nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from dvc.arrays import Bytes, Floats, Mask, Singles
from dvc.errors import ConfigError
from dvc.geometry.calibrated_cameras import NO_DISTORTION, Camera
from dvc.geometry.camera_array import LatticePosition
from dvc.stereo.rectification.camera_lattice import Lattice

SWAP = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0], [0, 0, 1.0, 0]])
"""H2 of (2.9): swap of depth and homogeneous coordinate; ``rectified_from_world`` has H1 of (2.8)."""
MAX_OBLIQUITY = 4.0
"""Largest ratio of the stretch at a corner and at the middle of a rectified picture."""
_BORDER_POINTS = 17
MAX_GROWTH = 1.25
"""Largest ratio of the pixels of a rectified picture and an original, by cropping and scaling."""
MIN_COVERED = 0.15
"""Mean share of covered pixels of a row or column that is not cropped."""
_CELLS = 128
_INWARDS = np.diag([1, 1, -1, -1])
MAX_RESAMPLED_SIDE = 2**15 - 2
"""Longest side of resampled pictures: OpenCV counts pixels in 16 bits."""
_DEPTH_EDGE_PX = 1.0


@dataclass(frozen=True, eq=False)
class Rectification:
    """Transformation of pictures of calibrated cameras into views of a planar array."""

    cameras: tuple[Camera, ...]
    lattice: Lattice
    positions: tuple[LatticePosition, ...]  # positions on the lattice
    focal_length_px: float  # focal length of the rectified cameras
    # disparity at which cameras off the plane are exact, in the frame of the equations
    middle_disparity: float
    offset: tuple[float, float] = (0.0, 0.0)  # added to (x, y) of the frame of the equations, in pixels
    disparity_shift: float = 0.0  # subtracted from its disparities
    size: tuple[int, int] = (0, 0)  # width and height of the rectified pictures

    def rectified_from_view(self, index: int) -> Floats:
        """Return the homography that rectifies a picture (2.11), with the common offset and shift."""
        camera, (m, n) = self.cameras[index], self.positions[index]
        height = self.lattice.coordinates(camera.centre[None])[0, 2]
        scale = 1.0 - height * self.middle_disparity / self.focal_length_px
        shift = np.diag([scale, scale, 1.0])
        shift[:2, 2] = np.array(self.offset) + self.disparity_shift * np.array([m, n])
        directions = np.linalg.inv(self.lattice.basis) @ camera.R.T @ np.linalg.inv(camera.K)
        return np.asarray(shift @ (self._intrinsics @ directions))

    @property
    def _intrinsics(self) -> Floats:
        """Intrinsics of all rectified cameras (2.7)."""
        return np.diag([self.focal_length_px, self.focal_length_px, 1.0])

    @property
    def rectified_from_world(self) -> Floats:
        """Homography of space (2.12), shape (4, 4): (X, 1) to (x, y, d, 1) in the frame of the pictures."""
        upper, first, translation = self._intrinsics @ np.linalg.inv(self.lattice.basis), np.eye(4), np.eye(4)
        first[:3, :3], first[:3, 3], first[3, 3] = upper, -upper @ self.lattice.origin, self.focal_length_px
        translation[:3, 3] = *self.offset, -self.disparity_shift
        return np.asarray(translation @ SWAP @ first)

    @property
    def world_from_rectified(self) -> Floats:
        """Inverse of `rectified_from_world`."""
        return np.asarray(np.linalg.inv(self.rectified_from_world), dtype=np.float64)

    def disparities(self, points: Floats) -> Floats:
        """Return the disparities of points of the scene."""
        distance = self.lattice.coordinates(points)[:, 2]
        with np.errstate(divide="ignore"):
            return np.asarray(self.focal_length_px / distance - self.disparity_shift)

    def rectified_points(self, index: int, points: Floats) -> Floats:
        """Return the positions in the rectified picture of points of a picture."""
        return _applied(self.rectified_from_view(index), self.cameras[index].undistorted(points))

    def border(self, index: int) -> Floats:
        """Return the border of a picture after rectification."""
        camera = self.cameras[index]
        width, height = camera.size
        x, y = np.linspace(0, width - 1, _BORDER_POINTS), np.linspace(0, height - 1, _BORDER_POINTS)
        sides = [(x, 0.0 * y), (x, 0.0 * y + height - 1), (0.0 * x, y), (0.0 * x + width - 1, y)]
        points = camera.undistorted(np.concatenate([np.column_stack(side) for side in sides]))
        homography = self.rectified_from_view(index)
        depth = np.column_stack([points, np.ones(len(points))]) @ homography[2]
        middle = np.array([0.5 * (width - 1), 0.5 * (height - 1), 1.0]) @ homography[2]
        if not (middle > 0.0 and depth.min() * MAX_OBLIQUITY > middle):
            raise ConfigError(
                f"{camera.name}: its camera looks along the plane of the cameras rather than away from it; "
                "such views cannot be rectified"
            )
        return _applied(homography, points)

    @property
    def is_identity(self) -> bool:
        """Whether the pictures are rectified already, and stay as they are."""
        for index, camera in enumerate(self.cameras):
            homography = self.rectified_from_view(index)
            near = np.abs(homography / homography[2, 2] - np.eye(3)).max() < 1e-6
            if not near or self.size != camera.size or camera.distortion != NO_DISTORTION:
                return False
        return True

    def off_plane_px(self, lowest: float, highest: float) -> Floats:
        """Return the largest error of (2.5) for each camera because cameras are not in one plane."""
        ends = np.array([lowest, highest]) + self.disparity_shift - self.middle_disparity
        worst = np.abs(ends).max() / self.focal_length_px
        centres = np.stack([camera.centre for camera in self.cameras])
        heights = np.abs(self.lattice.coordinates(centres)[:, 2])
        radii = [
            np.linalg.norm(
                self.border(index) - self.offset - self.disparity_shift * np.array(position), axis=1
            ).max()
            for index, position in enumerate(self.positions)
        ]
        return np.asarray(heights * np.array(radii) * worst)

    def to_dict(self) -> dict[str, Any]:
        """Return the homographies and their parameters as plain values for JSON."""
        views = [
            {
                "file": camera.name,
                **position._asdict(),
                "width": camera.size[0],
                "height": camera.size[1],
                "K": camera.K.tolist(),
                "R": camera.R.tolist(),
                "t": camera.t.tolist(),
                "distortion": list(camera.distortion),
                "rectified_from_view": self.rectified_from_view(index).tolist(),
            }
            for index, (camera, position) in enumerate(zip(self.cameras, self.positions, strict=True))
        ]
        return {
            "width": self.size[0],
            "height": self.size[1],
            "focal_length_px": self.focal_length_px,
            "middle_disparity": self.middle_disparity,
            "offset_px": list(self.offset),
            "disparity_shift": self.disparity_shift,
            "lattice": {key: getattr(self.lattice, key).tolist() for key in ("origin", "v1", "v2")},
            "rectified_from_world": self.rectified_from_world.tolist(),
            "views": views,
        }


def cropped(bare: Rectification) -> Rectification:
    """Choose offset and shift that align the middles of the pictures, a window round them, and its scale."""
    positions, sizes = np.array(bare.positions), np.array([camera.size for camera in bare.cameras])
    borders = [bare.border(index) for index in range(len(sizes))]
    middles = [bare.rectified_points(k, 0.5 * (size - 1)[None])[0] for k, size in enumerate(sizes)]
    spread = positions - positions.mean(axis=0)
    shift = -float((spread * np.stack(middles)).sum() / (spread**2).sum())
    hulls = [
        cv2.convexHull((border + position * shift).astype(np.float32))[:, 0]
        for border, position in zip(borders, positions, strict=True)
    ]
    num_pixels = float(np.mean(sizes.prod(axis=1)))
    shown = float(np.mean([cv2.contourArea(hull) for hull in hulls]))
    low, high = _window(hulls, MAX_GROWTH * max(num_pixels, shown))
    growth = float(np.prod(high - low)) / num_pixels
    scale = min(1.0, np.sqrt(MAX_GROWTH / growth))
    width, height = (int(side) for side in np.ceil(scale * (high - low) - 1e-3).astype(np.int64) + 1)
    return replace(
        bare,
        focal_length_px=scale * bare.focal_length_px,
        middle_disparity=scale * bare.middle_disparity,
        offset=(-scale * float(low[0]), -scale * float(low[1])),
        disparity_shift=scale * shift,
        size=(width, height),
    )


def _window(hulls: Sequence[Singles], most: float) -> tuple[Floats, Floats]:
    """Return the corners of a window round pictures; crop sides with low coverage if it is large."""
    corners = np.concatenate(hulls).astype(np.float64)
    low, high = corners.min(axis=0), corners.max(axis=0)
    cell = (high - low) / _CELLS
    covered = np.zeros((_CELLS, _CELLS))
    for hull in hulls:
        mask = np.zeros((_CELLS, _CELLS), np.uint8)
        covered += cv2.fillConvexPoly(mask, np.floor((hull - low) / cell).astype(np.int32), 1) / len(hulls)
    left, top, right, bottom = 0, 0, _CELLS, _CELLS
    while (right - left) * (bottom - top) * np.prod(cell) > most:
        inner = covered[top:bottom, left:right]
        shares = inner[:, 0].mean(), inner[0].mean(), inner[:, -1].mean(), inner[-1].mean()
        side = int(np.argmin(shares))
        if shares[side] >= MIN_COVERED:
            break
        left, top, right, bottom = np.add((left, top, right, bottom), _INWARDS[side])
    return low + cell * (left, top), low + cell * (right, bottom)


def resample(rectification: Rectification, index: int, picture: Bytes) -> tuple[Bytes, Mask]:
    """Rectify a picture by Lanczos interpolation; return it and the mask of its valid pixels."""
    homography = np.linalg.inv(rectification.rectified_from_view(index))
    homography = homography * np.sign(np.linalg.det(homography))
    points = _applied(homography, _grid(rectification.size))
    source = rectification.cameras[index].distorted(points).reshape(*rectification.size[::-1], 2)
    height, width = picture.shape[:2]
    slack = 1e-3
    valid: Mask = np.logical_and.reduce(
        [source >= -slack, source <= np.array([width - 1, height - 1]) + slack]
    ).all(axis=2)
    source = np.clip(np.nan_to_num(source, nan=-8.0), -8.0, [width + 8.0, height + 8.0])
    x, y = (np.ascontiguousarray(source[:, :, k], dtype=np.float32) for k in range(2))
    sampled = cv2.remap(picture, x, y, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT_101)
    return np.asarray(np.where(valid[:, :, None], sampled, 0), dtype=np.uint8), valid


def _grid(size: tuple[int, int]) -> Floats:
    y, x = np.mgrid[: size[1], : size[0]]
    return np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)


def to_original_view(rectification: Rectification, index: int, plane: Singles) -> Singles:
    """Resample disparities of a rectified picture at the pixels of the original one."""
    width, height = rectification.cameras[index].size
    target = rectification.rectified_points(index, _grid((width, height)))
    rows, columns = plane.shape
    x, y = (np.clip(target[:, k], 0.0, side - 1.0) for k, side in ((0, columns), (1, rows)))
    x0, y0 = (
        np.clip(np.floor(a).astype(np.int64), 0, max(side - 2, 0)) for a, side in ((x, columns), (y, rows))
    )
    x1, y1 = np.minimum(x0 + 1, columns - 1), np.minimum(y0 + 1, rows - 1)
    corners = np.stack([plane[y0, x0], plane[y0, x1], plane[y1, x0], plane[y1, x1]])
    u, v = x - x0, y - y0
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
    smooth = np.ptp(corners, axis=0) <= _DEPTH_EDGE_PX
    nearest = np.take_along_axis(corners, weights.argmax(axis=0)[None], axis=0)[0]
    values = np.where(smooth, (weights * corners).sum(axis=0), nearest)
    return np.asarray(values.reshape(height, width), dtype=np.float32)


def metric_depth(rectification: Rectification, index: int, disparity: Singles) -> Singles:
    """Return the depth along the optical axis of every pixel of an original picture, by (2.12)."""
    camera, position = rectification.cameras[index], rectification.positions[index]
    target = rectification.rectified_points(index, _grid(camera.size))
    d = disparity.astype(np.float64).ravel()
    rectified = np.column_stack([target + d[:, None] * np.array(position), d, np.ones(len(d))])
    world = rectified @ rectification.world_from_rectified.T
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (world[:, :3] / world[:, 3:]) @ camera.R[2] + camera.t[2]
    beyond = d + rectification.disparity_shift <= 0.0
    depth = np.where(beyond | ~(depth > 0.0), np.inf, depth)
    return np.asarray(depth.reshape(camera.size[::-1]), dtype=np.float32)


def _applied(homography: Floats, points: Floats) -> Floats:
    image = points @ homography[:, :2].T + homography[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(image[:, 2:] > 0.0, image[:, :2] / image[:, 2:], np.nan))
