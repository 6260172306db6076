"""Errors of rendered views: what a map of labels causes where views are rendered forward from it (3.5)."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity.distortion import Holes, Plane, subtract_hole_errors
from dvc.dibr.disparity.error_tensor import Tensor
from dvc.dibr.disparity.integer_transforms import Labels
from dvc.dibr.view_rendering import PictureAndDisparity, picture_of, render_pairs
from dvc.geometry.camera_array import DisparityLabels
from dvc.geometry.viewpoints import Viewpoint, warp_between
from dvc.images.colour import Picture

Floats = NDArray[np.float64]

SAME_SURFACE_LABELS = 1.5
"""How far behind what is drawn a label still counts as seen."""


class ForwardErrors:
    """Errors of the views that one decoded picture predicts; see `Distortion`."""

    def __init__(
        self,
        picture: Picture,
        viewpoint: Viewpoint,
        labels: DisparityLabels,
        views: Sequence[tuple[Picture, Viewpoint]],
    ) -> None:
        self._picture, self._viewpoint, self._labels, self._views = picture, viewpoint, labels, views
        self._warps = [warp_between(viewpoint, place) for _, place in views]
        self._inverse_depths = labels.disparity(np.arange(labels.num_labels, dtype=np.float64))
        motions = [parallax_px(warp, picture.shape, self._inverse_depths) for warp in self._warps]
        self.parallax = sum(motions) / (len(views) + 1)

    def measure(self, labels: Labels) -> tuple[float, list[Holes]]:
        """Render all views; see `Distortion`."""
        disparity = self._labels.disparity(labels.astype(np.float64))
        pair = PictureAndDisparity(self._picture, disparity, self._viewpoint)
        total, holes = 0.0, []
        for truth, place in self._views:
            view = render_pairs([pair], place, self._labels.step)
            errors = squared_errors(picture_of(view), truth)
            total += float(errors.sum(dtype=np.float64))
            first_label = np.where(view.drawn, self._first_label_before(view.inverse_depth), 0)
            holes.append(Holes(np.where(view.drawn, np.float32(0.0), errors), first_label.astype(np.int32)))
        return total / (len(self._views) + 1), holes

    def _first_label_before(self, inverse_depth: Floats) -> Labels:
        """Return the lowest labels that are seen before a surface, or as part of it."""
        lowest, step, num_labels = self._labels
        first = np.ceil((inverse_depth - lowest) / step - SAME_SURFACE_LABELS)
        return np.clip(first, 0, num_labels).astype(np.int32)

    def claimed(self, tensor: Tensor, holes: Sequence[Holes], weight: float) -> Tensor:
        """Credit labels that would cover holes; see `Distortion`."""
        return subtract_hole_errors(tensor, holes, self._warps, self._inverse_depths, weight)


def parallax_px(warp: Floats, shape: tuple[int, ...], inverse_depths: Floats) -> float:
    """Return how far the middle of a picture moves in another view from one label to the next."""
    if len(inverse_depths) < 2:
        return 0.0
    middle = np.array([(shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0, 1.0])
    ends = warp[:, :3] @ middle + inverse_depths[[0, -1], None] * warp[:, 3]
    first, last = ends[:, :2] / ends[:, 2:]
    return float(np.hypot(*(last - first))) / (len(inverse_depths) - 1)


def squared_errors(found: Picture, truth: Picture) -> Plane:
    """Return the squared errors of a picture, intensities from 0 to 1."""
    difference = (found.astype(np.float32) - truth) / np.float32(255.0)
    errors = difference * difference
    return np.asarray(errors if errors.ndim == 2 else errors.mean(axis=2), np.float32)
