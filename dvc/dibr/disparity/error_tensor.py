"""Error tensor: how well each disparity label predicts the other views at each pixel of the reference.

Views are compensated backwards: each is sampled where it would see a pixel of the reference if that had the
label's disparity, or depth. Where this is depends on the label by a homography, which for rectified views is
a translation.

References
----------
[Maitre2008] Eqs. (3.6), (3.12), (3.31).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity import _kernels
from dvc.multiview.camera_array import DisparityLabels, LatticePosition

Floats = NDArray[np.float64]
Tensor = NDArray[np.float32]


class SamplingMap(Protocol):
    """Where a view sees the pixels of the reference, by label."""

    def view_from_reference(self) -> Floats:
        """Return a homography for each label.

        Returns
        -------
        ndarray of shape (labels, 3, 3), float64
            From (x, y, 1) in the reference to the view.
        """


@dataclass(frozen=True)
class RectifiedTranslation:
    """The map of rectified views: along the line between the cameras.

    Attributes
    ----------
    position : LatticePosition
        Of the view, from that of the reference.
    labels : DisparityLabels
        Disparities.
    """

    position: LatticePosition
    labels: DisparityLabels

    def view_from_reference(self) -> Floats:
        """Return a translation for each label; see `SamplingMap`."""
        disparities = self.labels.disparity(np.arange(self.labels.num_labels, dtype=np.float64))
        maps = np.tile(np.eye(3), (disparities.size, 1, 1))
        maps[:, 0, 2] = -self.position.m * disparities
        maps[:, 1, 2] = -self.position.n * disparities
        return maps


@dataclass(frozen=True, eq=False)
class PlaneInduced:
    """The map of general cameras, by planes of constant depth in the frame of the reference.

    Attributes
    ----------
    reference_intrinsics, view_intrinsics : ndarray of shape (3, 3), float64
        Upper triangular matrices K_0 and K_v.
    rotation : ndarray of shape (3, 3), float64
        From the frame of the reference to that of the view.
    translation : ndarray of shape (3,), float64
        Likewise.
    inverse_depth : DisparityLabels
        1 / z of the labels; 0 is the plane at infinity.
    """

    reference_intrinsics: Floats
    view_intrinsics: Floats
    rotation: Floats
    translation: Floats
    inverse_depth: DisparityLabels

    def view_from_reference(self) -> Floats:
        """Return ``K_v (R + t e_3^T / z) K_0^-1`` for each label; see `SamplingMap`."""
        inverse = self.inverse_depth.disparity(np.arange(self.inverse_depth.num_labels, dtype=np.float64))
        planes = np.tile(self.rotation, (inverse.size, 1, 1))
        planes[:, :, 2] += inverse[:, None] * self.translation
        maps: Floats = self.view_intrinsics @ planes @ np.linalg.inv(self.reference_intrinsics)
        return maps


def error_tensor(
    reference: NDArray[np.floating], views: Sequence[NDArray[np.floating]], maps: Sequence[SamplingMap]
) -> Tensor:
    """Return the squared error of each label at each pixel, per view.

    Pixels outside a view are left out, and the others stand for them. Where no view sees a pixel at some
    label, nothing speaks against this label: it has the least error of those seen there.

    Parameters
    ----------
    reference : ndarray of shape (H, W) or (H, W, channels), float
        The decoded reference, from 0 to 1.
    views : sequence of ndarray, float
        The other views, from 0 to 1, of the same channels and any size; at least one. Samples that are not
        finite have seen nothing. Several channels count by their mean.
    maps : sequence of SamplingMap
        One for each view, all of the same labels.

    Returns
    -------
    ndarray of shape (H, W, labels), float32
        ``1 / N_v`` times the sum of squared differences, where ``N_v`` counts the reference, too.

    Raises
    ------
    ValueError
        If there is no view, or channels or numbers of labels differ.
    """
    if not views or len(views) != len(maps):
        raise ValueError(f"`views` must be at least one, with a map each, got {len(views)}, {len(maps)}")
    homographies = [view_map.view_from_reference() for view_map in maps]
    if len({len(of_view) for of_view in homographies}) > 1:
        raise ValueError("`maps` must have the same labels")
    planes = [_with_channels(view) for view in views]
    target = _with_channels(reference)
    if any(plane.shape[2] != target.shape[2] for plane in planes):
        raise ValueError("`views` must have the channels of the reference")
    tensor = np.zeros((*target.shape[:2], len(homographies[0])), np.float32)
    count = np.zeros(tensor.shape, np.uint8 if len(views) < 256 else np.uint16)
    for plane, of_view in zip(planes, homographies, strict=True):
        _kernels.add_squared_errors(target, plane, of_view, tensor, count)
    _kernels.normalise_errors(tensor, count, len(views))
    return tensor


def _with_channels(image: NDArray[np.floating]) -> NDArray[np.float32]:
    return np.ascontiguousarray(image.reshape(*image.shape[:2], -1), np.float32)
