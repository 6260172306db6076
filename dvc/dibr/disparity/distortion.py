"""Squared errors of maps: as the error tensor knows them, or as rendering finds them.

Backward compensation knows nothing of the holes that a map opens when other views are rendered forward
from it. Where these errors are known, the codecs choose by them.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.disparity import _kernels
from dvc.dibr.disparity.error_tensor import Tensor
from dvc.dibr.disparity.integer_transforms import Labels

Floats = NDArray[np.float64]
Plane = NDArray[np.float32]

CREDITS = 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5
"""Shares of the errors in holes to credit labels with that would cover them, one after the other."""


class Holes(NamedTuple):
    """What is not drawn in one view."""

    errors: Plane  # squared errors, 0 where something is drawn
    # lowest label that would be seen: 0 in holes, elsewhere the first one before what is drawn
    first_label: Labels


class Distortion(Protocol):
    """What maps cause in the rendered views."""

    parallax: float
    """Motion per label in px, mean of all views with the reference."""

    def measure(self, labels: Labels) -> tuple[float, list[Holes]]:
        """Return the squared error of a map (of all pixels, mean of views and reference), and its holes."""

    def claimed(self, tensor: Tensor, holes: Sequence[Holes], weight: float) -> Tensor:
        """Return a tensor in which labels that would cover a hole have less error, by a share of its own."""


def still_worth_covering(holes: Sequence[Holes], before: Sequence[Holes]) -> list[Holes]:
    """Return holes of a map with those that were there before: these may open again."""
    return [
        now._replace(errors=np.where(now.errors > 0.0, now.errors, was.errors))
        for now, was in zip(holes, before, strict=True)
    ]


def subtract_hole_errors(
    tensor: Tensor, holes: Sequence[Holes], warps: Sequence[Floats], inverse_depths: Floats, weight: float
) -> Tensor:
    """Credit each label with the errors in holes where it would draw its pixel, if that would be seen."""
    credited = tensor.copy()
    share = np.float32(weight / (len(holes) + 1))
    for (errors, first_label), warp in zip(holes, warps, strict=True):
        homographies = np.tile(warp[:, :3], (len(inverse_depths), 1, 1))
        homographies[:, :, 2] += inverse_depths[:, None] * warp[:, 3]
        _kernels.subtract_at_labels(errors, first_label, _adjugates(homographies), share, credited)
    return credited


def _adjugates(homographies: Floats) -> Floats:
    """Return the inverses of homographies, but for positive scales; zeros where they are singular."""
    rows = homographies.transpose(1, 0, 2)
    columns = [np.cross(rows[(k + 1) % 3], rows[(k + 2) % 3]) for k in range(3)]
    determinants = (rows[0] * columns[0]).sum(axis=1)
    adjugates: Floats = np.stack(columns, axis=2) * np.sign(determinants)[:, None, None]
    return adjugates


def backward_error(tensor: Tensor, labels: Labels) -> float:
    """Return the squared error of a map, as the tensor knows it."""
    return float(np.take_along_axis(tensor, labels[:, :, None], 2).sum(dtype=np.float64))
