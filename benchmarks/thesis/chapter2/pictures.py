"""Views, disparities and errors as panels of figures 2.4, 2.5 and 2.9, in blue, green and red."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.geometry.camera_array import ArrayView, DisparityLabels
from dvc.geometry.surfaces import Reconstruction
from dvc.stereo.evaluation import disparity_error
from dvc.web.drawing import Picture, colour_disparity, colour_error, in_rows, with_title

Floats = NDArray[np.floating]


def view_panel(view: ArrayView) -> Picture:
    """Draw a view with its position."""
    title = f"view ({view.position.m:g}, {view.position.n:g})"
    return with_title(np.ascontiguousarray(view.image[:, :, ::-1]), title)


def disparity_panels(
    disparity: Floats,
    truth: Floats,
    labels: DisparityLabels,
    title: str,
    mask: NDArray[np.bool_] | None = None,
) -> list[Picture]:
    """Draw a disparity map and its errors."""
    error, counted = disparity_error(disparity, truth, mask)
    bad = 100.0 * float(np.mean(error[counted] > 1.0))
    return [
        with_title(colour_disparity(disparity, labels.lowest, labels.highest), title),
        with_title(colour_error(error, counted), f"{bad:.2f} % bad"),
    ]


def figure_2_4(truth: Sequence[Floats], by_iteration: Mapping[int, Reconstruction]) -> Picture:
    """Draw how the occlusion model works: views, then disparities and errors after each iteration."""
    first = next(iter(by_iteration.values()))
    rows = [[_enlarged(np.ascontiguousarray(view.image[:, :, ::-1]), view.name) for view in first.array]]
    for iteration, found in by_iteration.items():
        low, high = found.labels.lowest, found.labels.highest
        maps = [colour_disparity(surface.disparity, low, high) for surface in found.surfaces]
        rows.append([_enlarged(one, f"iteration {iteration}") for one in maps])
        errors = [
            disparity_error(surface.disparity, known)
            for surface, known in zip(found.surfaces, truth, strict=True)
        ]
        bad = [100.0 * float(np.mean(error[counted] > 1.0)) for error, counted in errors]
        drawn = zip(errors, bad, strict=True)
        rows.append([_enlarged(colour_error(*error), f"{percent:.1f} % bad") for error, percent in drawn])
    return in_rows([panel for row in rows for panel in row], len(first.array))


def _enlarged(picture: Picture, title: str) -> Picture:
    doubled = cv2.resize(picture, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    return with_title(np.asarray(doubled, np.uint8), title)
