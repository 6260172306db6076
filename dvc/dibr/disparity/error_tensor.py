"""Squared errors of disparity maps: those of each label at each pixel, and those of rendered views.

Views are compensated backwards: each is sampled where it would see a pixel of the reference if that had the
disparity, or depth, of the label. This position depends on the label by a homography, which is a translation
for rectified views. Backward compensation ignores the holes that a map opens when other views are rendered
forward from it. If these errors are known, the codecs choose by them.

References
----------
[Maitre2008] Eqs. (3.5), (3.6), (3.12), (3.31).
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.dibr.disparity.integer_transforms import Labels

Floats = NDArray[np.float64]
Plane = NDArray[np.float32]
Counts = NDArray[np.uint8]
Tensor = NDArray[np.float32]
"""Errors of shape (rows, columns, labels)."""

MARGIN = 1e-6
"""Largest distance in px of a position from the picture, for rounding."""


class Holes(NamedTuple):
    """Holes of one view."""

    errors: Plane  # squared errors in holes, 0 elsewhere
    first_label: (
        Labels  # lowest label that would be seen: 0 in holes, elsewhere the first in front of the surface
    )


class Distortion(Protocol):
    """Errors of the rendered views."""

    parallax: float
    """Motion per label in px, mean of all views with the reference."""

    def measure(self, labels: Labels) -> tuple[float, list[Holes]]:
        """Return the squared error of a map (sum over pixels, mean of views and reference), and its holes."""

    def claimed(self, tensor: Tensor, holes: Sequence[Holes], weight: float) -> Tensor:
        """Return a tensor that credits labels which would cover a hole with a share of its error."""


def error_tensor(
    reference: NDArray[np.floating],
    views: Sequence[NDArray[np.floating]],
    warps: Sequence[Floats],
    inverse_depths: Floats,
) -> Tensor:
    """Return the squared error of each label at each pixel, per view."""
    if not 0 < len(views) < 256 or len(views) != len(warps):
        raise ValueError(f"`views` must be 1 to 255, with a warp each, got {len(views)}, {len(warps)}")
    planes, target = [_with_channels(view) for view in views], _with_channels(reference)
    if any(plane.shape[2] != target.shape[2] for plane in planes):
        raise ValueError("`views` must have the channels of the reference")
    tensor = np.zeros((*target.shape[:2], len(inverse_depths)), np.float32)
    count = np.zeros(tensor.shape, np.uint8)
    for plane, warp in zip(planes, warps, strict=True):
        _add_squared_errors(target, plane, _homographies(warp, inverse_depths), tensor, count)
    _normalise_errors(tensor, count, len(views))
    return tensor


def _with_channels(image: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.ascontiguousarray(image.reshape(*image.shape[:2], -1), np.float32)


def _homographies(warp: Floats, inverse_depths: Floats) -> Floats:
    homographies = np.tile(warp[:, :3], (len(inverse_depths), 1, 1))
    homographies[:, :, 2] += inverse_depths[:, None] * warp[:, 3]
    return homographies


def subtract_hole_errors(
    tensor: Tensor, holes: Sequence[Holes], warps: Sequence[Floats], inverse_depths: Floats, weight: float
) -> Tensor:
    """Credit each label with the errors in holes that it would cover."""
    credited = tensor.copy()
    share = np.float32(weight / (len(holes) + 1))
    for (errors, first_label), warp in zip(holes, warps, strict=True):
        inverse = adjugates(_homographies(warp, inverse_depths))
        _subtract_at_labels(errors, first_label, inverse, share, credited)
    return credited


def adjugates(homographies: Floats) -> Floats:
    """Return the inverses of homographies, up to positive scales; zeros if they are singular."""
    rows = homographies.transpose(1, 0, 2)
    columns = [np.cross(rows[(k + 1) % 3], rows[(k + 2) % 3]) for k in range(3)]
    determinants = (rows[0] * columns[0]).sum(axis=1)
    return np.asarray(np.stack(columns, axis=2) * np.sign(determinants)[:, None, None])


@kernel
def _add_squared_errors(
    target: Tensor, view: Tensor, homographies: Floats, tensor: Tensor, count: Counts
) -> None:
    """Add the squared errors of one view at every label, and count the pixels that it sees."""
    height, width, channels = view.shape
    share = np.float32(1.0 / channels)
    labels = tensor.shape[2]
    for m in range(tensor.shape[0]):
        for n in range(tensor.shape[1]):
            for k in range(labels):
                h = homographies[k]
                x = h[0, 0] * n + h[0, 1] * m + h[0, 2]
                y = h[1, 0] * n + h[1, 1] * m + h[1, 2]
                z = h[2, 0] * n + h[2, 1] * m + h[2, 2]
                if z != 1.0:
                    if z <= 0.0:
                        continue
                    x, y = x / z, y / z
                if not (-MARGIN <= x <= width - 1 + MARGIN and -MARGIN <= y <= height - 1 + MARGIN):
                    continue
                x0, y0 = min(max(int(x), 0), width - 1), min(max(int(y), 0), height - 1)
                x1, y1 = min(x0 + 1, width - 1), min(y0 + 1, height - 1)
                right, down = np.float32(x - x0), np.float32(y - y0)
                total = np.float32(0.0)
                for c in range(channels):
                    value = view[y0, x0, c]
                    if right != 0.0:
                        value += right * (view[y0, x1, c] - value)
                    if down != 0.0:
                        lower = view[y1, x0, c]
                        if right != 0.0:
                            lower += right * (view[y1, x1, c] - lower)
                        value += down * (lower - value)
                    total += (value - target[m, n, c]) ** 2
                if np.isfinite(total):
                    tensor[m, n, k] += share * total
                    count[m, n, k] += 1


@kernel
def _normalise_errors(tensor: Tensor, count: Counts, num_views: int) -> None:
    """Turn sums over the views that see a pixel into shares of all views, the reference included."""
    height, width, labels = tensor.shape
    for m in range(height):
        for n in range(width):
            total, num_seen = 0.0, 0
            for k in range(labels):
                seen = np.float32(count[m, n, k])
                if seen > 0:
                    tensor[m, n, k] *= np.float32(num_views) / (seen * np.float32(num_views + 1))
                    total += tensor[m, n, k]
                    num_seen += 1
            blind = np.float32(total / num_seen) if num_seen > 0 else np.float32(0.0)
            for k in range(labels):
                if count[m, n, k] == 0:
                    tensor[m, n, k] = blind


@kernel
def _subtract_at_labels(
    plane: Plane, first_label: Labels, homographies: Floats, weight: np.float32, tensor: Tensor
) -> None:
    """Subtract values of a plane from labels, from a first one on, that would draw there."""
    height, width, labels = tensor.shape
    for i in range(plane.shape[0]):
        for j in range(plane.shape[1]):
            if plane[i, j] == 0.0:
                continue
            for k in range(first_label[i, j], labels):
                h = homographies[k]
                z = h[2, 0] * j + h[2, 1] * i + h[2, 2]
                if z <= 0.0:
                    continue
                n = np.int64(np.floor((h[0, 0] * j + h[0, 1] * i + h[0, 2]) / z + 0.5))
                m = np.int64(np.floor((h[1, 0] * j + h[1, 1] * i + h[1, 2]) / z + 0.5))
                if 0 <= n < width and 0 <= m < height:
                    tensor[m, n, k] -= weight * plane[i, j]
