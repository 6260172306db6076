"""Plain twins of the estimation of cameras, one point at a time from the equations."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def sampson_distance(fundamental: Floats, first: Floats, second: Floats) -> float:
    """Return e / |gradient of e| for one pair of points, the gradient by the four coordinates."""
    x0, x1 = np.array([*first, 1.0]), np.array([*second, 1.0])
    gradient = np.concatenate([(fundamental.T @ x1)[:2], (fundamental @ x0)[:2]])
    return float(x1 @ fundamental @ x0 / np.linalg.norm(gradient))


def distance_to_line(line: Floats, point: Floats) -> float:
    """Return the distance of a point from a line of any scale."""
    return float(abs(line @ np.array([*point, 1.0])) / np.hypot(line[0], line[1]))


def seven_point(first: Floats, second: Floats) -> list[Floats]:
    """Return all matrices of rank 2 and unit norm that seven pairs obey."""
    rows = [np.outer([*b, 1.0], [*a, 1.0]).ravel() for a, b in zip(first, second, strict=True)]
    vt = np.linalg.svd(np.array(rows))[2]
    a, b = vt[7].reshape(3, 3), vt[8].reshape(3, 3)
    at = np.array([-1.0, 0.0, 1.0, 2.0])
    cubic = np.polyfit(at, [np.linalg.det(z * a + b) for z in at], 3)
    real = [root.real for root in np.roots(cubic) if abs(root.imag) < 1e-7 * (1 + abs(root.real))]
    models = [z * a + b for z in real]
    return [model / np.linalg.norm(model) for model in models]


def reprojection_error(first: Floats, depths: Floats, observed: Floats, camera: Floats) -> float:
    """Return J of (5.6)."""
    total = 0.0
    p = camera.ravel()
    for x, depth, (u, v) in zip(first, depths, observed, strict=True):
        row = np.array([depth * x[0], depth * x[1], depth, 1.0])
        total += (u - row @ p[0:4] / (row @ p[8:12])) ** 2 + (v - row @ p[4:8] / (row @ p[8:12])) ** 2
    return float(total)


def camera_step(first: Floats, depths: Floats, observed: Floats, kappa: Floats, basis: Floats) -> Floats:
    """Return the camera of (B.3), by the singular vectors of the stacked blocks."""
    blocks = []
    for x, depth, (u, v), k in zip(first, depths, observed, kappa, strict=True):
        lx = depth * np.array([*x, 1.0])
        zero = np.zeros(3)
        blocks.append(
            np.sqrt(3.0)
            * k
            * np.array(
                [
                    [*-lx, -1.0, *zero, 0.0, *(u * lx), u],
                    [*zero, 0.0, *-lx, -1.0, *(v * lx), v],
                ]
            )
            @ basis
        )
    r = np.linalg.svd(np.vstack(blocks))[2][-1]
    camera: Floats = np.sqrt(3.0) * (basis @ r).reshape(3, 4)
    return camera


def depth_step(first: Floats, observed: Floats, camera: Floats) -> Floats:
    """Return the depths of (B.4)."""
    p = camera.ravel()
    depths = []
    for x, (u, v) in zip(first, observed, strict=True):
        homogeneous = np.array([*x, 1.0])
        a = np.array([(u * p[8:11] - p[0:3]) @ homogeneous, (v * p[8:11] - p[4:7]) @ homogeneous])
        b = np.array([u * p[11] - p[3], v * p[11] - p[7]])
        depths.append(-(a @ b) / (a @ a))
    return np.array(depths)


def adjust(
    first: Floats, depths: Floats, observed: Floats, cameras: Floats, basis: Floats, fixed: Any
) -> float:
    """Minimise (5.7) over free depths, free cameras and the coordinates of the last; returns the least J."""
    from scipy.optimize import least_squares

    free = np.setdiff1d(np.arange(len(depths)), fixed)
    split = len(free), len(free) + 12 * (len(cameras) - 1)

    def errors(values: Floats) -> Floats:
        all_depths = depths.copy()
        all_depths[free] = values[: split[0]]
        points = np.column_stack(
            [all_depths[:, None] * np.column_stack([first, np.ones(len(first))]), np.ones(len(first))]
        )
        all_cameras = [
            *values[split[0] : split[1]].reshape(-1, 3, 4),
            (basis @ values[split[1] :]).reshape(3, 4),
        ]
        found = []
        for camera, seen in zip(all_cameras, observed, strict=True):
            p = points @ camera.T
            found.append((p[:, :2] / p[:, 2:] - seen).ravel())
        return np.concatenate(found)

    start = np.concatenate([depths[free], cameras[:-1].ravel(), basis.T @ cameras[-1].ravel()])
    solved = least_squares(errors, start, x_scale="jac", ftol=1e-13, xtol=1e-13, gtol=1e-15, max_nfev=400)
    return float(2.0 * solved.cost)
