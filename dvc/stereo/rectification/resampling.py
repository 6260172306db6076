"""Pictures brought to the rectified space, and disparities back to the original pictures."""

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.stereo.rectification.rectified_space import Rectification

Floats = NDArray[np.float64]

MAX_SIDE = 2**15 - 2
"""Of pictures that are resampled: OpenCV counts pixels in 16 bits."""
_DEPTH_EDGE_PX = 1.0


def resample(
    rectification: Rectification, index: int, picture: NDArray[np.uint8]
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Rectify a picture, by Lanczos interpolation."""
    place = rectification.view_points(index, _grid(rectification.size)).reshape(*rectification.size[::-1], 2)
    height, width = picture.shape[:2]
    slack = 1e-3
    valid: NDArray[np.bool_] = np.logical_and.reduce(
        [place >= -slack, place <= np.array([width - 1, height - 1]) + slack]
    ).all(axis=2)
    place = np.clip(np.nan_to_num(place, nan=-8.0), -8.0, [width + 8.0, height + 8.0])
    x, y = (np.ascontiguousarray(place[:, :, k], dtype=np.float32) for k in range(2))
    sampled = cv2.remap(picture, x, y, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT_101)
    return np.asarray(np.where(valid[:, :, None], sampled, 0), dtype=np.uint8), valid


def _grid(size: tuple[int, int]) -> Floats:
    y, x = np.mgrid[: size[1], : size[0]]
    return np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)


def to_original_view(
    rectification: Rectification, index: int, plane: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Bring disparities of a rectified picture to the pixels of the original one."""
    width, height = rectification.cameras[index].size
    place = rectification.rectified_points(index, _grid((width, height)))
    rows, columns = plane.shape
    x, y = (np.clip(place[:, k], 0.0, side - 1.0) for k, side in ((0, columns), (1, rows)))
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


def metric_depth(
    rectification: Rectification, index: int, disparity: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the depth along the optical axis of every pixel of an original picture, by (2.12)."""
    camera, position = rectification.cameras[index], rectification.positions[index]
    place = rectification.rectified_points(index, _grid(camera.size))
    d = disparity.astype(np.float64).ravel()
    rectified = np.column_stack([place + d[:, None] * np.array(position), d, np.ones(len(d))])
    world = rectified @ rectification.world_from_rectified.T
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (world[:, :3] / world[:, 3:]) @ camera.R[2] + camera.t[2]
    beyond = d + rectification.disparity_shift <= 0.0
    depth = np.where(beyond | ~(depth > 0.0), np.inf, depth)
    return np.asarray(depth.reshape(camera.size[::-1]), dtype=np.float32)
