"""Figures 3.9 to 3.12: levels, disparities by method and rate, rendered views and their errors."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.thesis.chapter3.curves import Curves, Point
from benchmarks.thesis.chapter3.scenes import Scene
from benchmarks.thesis.chapter3.tables import title as title_of
from dvc.dibr.disparity.coding import all_significant
from dvc.dibr.disparity.disparity_codec import DisparityCodec
from dvc.dibr.disparity.dynamic_programming import optimise_tree
from dvc.dibr.disparity.error_tensor import error_tensor
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM
from dvc.dibr.disparity.rate_model import laplacian_costs
from dvc.dibr.views.decoder import decode
from dvc.dibr.views.encoder import Encoded
from dvc.dibr.views.stream import decode_stream
from dvc.dibr.views.views import Views
from dvc.geometry.camera_array import DisparityLabels
from dvc.geometry.viewpoints import warp_between
from dvc.images.colour import Picture as View
from dvc.web.drawing import Picture, colour_disparity, in_rows, with_title

ERROR_GAIN = 3
"""Differences are drawn so many times as large."""
ERROR_QUANTILE, MATRIX_SCALE = 0.95, 3
"""Errors that are drawn white, and how many times as large a matrix of errors is drawn."""
PATH_COLOURS = (255, 120, 0), (40, 40, 255)
LEVELS = 0, 2, 4, 6
"""Resolutions of figure 3.9."""


def coloured(disparity: NDArray[np.floating], labels: DisparityLabels) -> Picture:
    """Colour disparities by the range of their labels."""
    return colour_disparity(disparity, labels.lowest, labels.highest)


def difference(found: View, truth: View) -> View:
    """Draw the difference between two gray pictures around a mid gray."""
    levels = 128.0 + ERROR_GAIN * (found.astype(np.float64) - truth)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def resolution_levels(encoded: Encoded, labels: DisparityLabels, codec: DisparityCodec) -> Picture:
    """Draw figure 3.9: picture and disparities at several resolutions, enlarged to one size."""
    stream = decode_stream(encoded.data)
    height, width = stream.header.shape
    tops, bottoms = [], []
    for level in LEVELS:
        if min(height, width) < 4 << level:
            break
        pair = decode(stream, resolution=level, codec=codec).pairs[0]
        rows, columns = pair.picture.shape[:2]
        label = f"level {level}: {columns}x{rows}"
        tops.append(with_title(_enlarged(pair.picture, (height, width)), label))
        full = coloured(pair.disparity * 2.0**level, labels)
        bottoms.append(with_title(_enlarged(full, (height, width)), f"disparity, level {level}"))
    return in_rows([*tops, *bottoms], len(tops))


def error_matrix(scene: Scene) -> Picture:
    """Draw figure 3.4: squared errors of the middle row, and its best disparities for two lambdas."""
    views, labels = scene.views, scene.labels
    row = views.shape[0] // 2
    own = views.references[0]
    others = [index for index in range(len(views.pictures)) if index != own]
    warps = [warp_between(views.viewpoints[own], views.viewpoints[index]) for index in others]
    disparities = labels.disparity(np.arange(labels.num_labels, dtype=np.float64))
    pictures = [views.pictures[index] / 255.0 for index in others]
    tensor = error_tensor(views.pictures[own] / 255.0, pictures, warps, disparities)[row : row + 1]
    shape = 1, tensor.shape[1]
    brightest = max(float(np.quantile(tensor, ERROR_QUANTILE)), 1e-9)
    levels = np.rint(255.0 * np.clip(tensor[0].T / brightest, 0.0, 1.0)).astype(np.uint8)
    drawn = (
        np.repeat(levels[::-1, :, None], 3, axis=2).repeat(MATRIX_SCALE, axis=0).repeat(MATRIX_SCALE, axis=1)
    )
    for mu, colour in ((0.0, PATH_COLOURS[0]), (1e6, PATH_COLOURS[1])):
        costs = laplacian_costs(shape, all_significant(shape), mu)
        tree, _ = optimise_tree(L_TRANSFORM, tensor, costs)
        path = (labels.num_labels - 1 - tree.disparity()[0]).astype(np.int64)
        corners = (np.stack([np.arange(shape[1]), path], axis=1) + 0.5) * MATRIX_SCALE
        cv2.polylines(drawn, [np.rint(corners).astype(np.int32)], False, colour, 1, cv2.LINE_AA)
    return with_title(np.ascontiguousarray(drawn), f"row {row}; blue: lambda = 0, red: infinite")


def disparity_maps(curves: Curves, indices: Sequence[int], labels: DisparityLabels) -> Picture:
    """Draw figures 3.10 and 3.11: decoded references, and disparities of all methods, at several rates."""
    first = next(iter(curves.values()))
    panels = [
        with_title(first[index].pair.picture, f"reference, {first[index].reference_bpp:.2f} bpp")
        for index in indices
    ]
    for method, points in curves.items():
        for index in indices:
            share = f"{8.0 * points[index].disparity_bytes / points[index].num_pixels:.3f} bpp"
            panels.append(
                with_title(coloured(points[index].pair.disparity, labels), f"{title_of(method)}, {share}")
            )
    return in_rows(panels, len(indices))


def rendered_panels(views: Views, points: Sequence[Point], view: int) -> Picture:
    """Draw figure 3.12: a view rendered at several rates, and its errors."""
    truth = views.pictures[view]
    tops = [
        with_title(point.rendered[view], f"{point.rate_bpp:.2f} bpp: {point.quality.by_view_db[view]:.2f} dB")
        for point in points
    ]
    bottoms = [
        with_title(difference(point.rendered[view], truth), f"difference, {ERROR_GAIN} times")
        for point in points
    ]
    return in_rows([*tops, with_title(truth, "as the camera saw it"), *bottoms], len(points) + 1)


def decompositions(points: Mapping[str, Point], labels: DisparityLabels) -> Picture:
    """Draw disparities by decomposition."""
    panels = [
        with_title(coloured(point.pair.disparity, labels), f"{label}: {point.quality.pooled_db:.2f} dB")
        for label, point in points.items()
    ]
    return in_rows(panels, len(panels))


def _enlarged(picture: NDArray[np.uint8], shape: tuple[int, int]) -> NDArray[np.uint8]:
    resized = cv2.resize(picture, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    return np.asarray(resized, np.uint8)
