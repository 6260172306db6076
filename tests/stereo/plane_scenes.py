"""Scenes of planes parallel to the cameras or slanted, with exact views and surfaces."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.camera_array import (
    ArrayView,
    CameraArray,
    DisparityLabels,
    LatticePosition,
    Reconstruction,
    Surface,
)

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Plane:
    """A rectangle of the frame of camera (0, 0) with the disparity ``d + slope * x``."""

    disparity: float
    columns: tuple[float, float] = (-np.inf, np.inf)
    rows: tuple[float, float] = (-np.inf, np.inf)
    slope: float = 0.0


def colour_of(number: int, x: Floats, y: Floats) -> NDArray[np.uint8]:
    """Return the texture of a plane, smooth, and different for each."""
    waves = [
        np.sin(0.31 * x + 0.17 * y + k + 2 * number) + np.cos(0.23 * y - 0.11 * x * (k + 1)) for k in range(3)
    ]
    return np.rint(127.5 + 50.0 * np.stack(waves, axis=-1)).astype(np.uint8)


def reconstruction_of(
    planes: Sequence[Plane],
    positions: Sequence[tuple[float, float]],
    labels: DisparityLabels,
    shape: tuple[int, int] = (40, 60),
) -> Reconstruction:
    """Return the true surfaces of cameras; the first plane must be seen wherever no other one is."""
    y, x = np.indices(shape, np.float64)
    views, surfaces = [], []
    for m, n in positions:
        disparity = np.full(shape, -np.inf)
        image = np.zeros((*shape, 3), np.uint8)
        for number, plane in enumerate(planes):
            column = (x + m * plane.disparity) / (1.0 - m * plane.slope)
            here = plane.disparity + plane.slope * column
            row = y + n * here
            seen = (plane.columns[0] <= column) & (column < plane.columns[1])
            seen &= (plane.rows[0] <= row) & (row < plane.rows[1]) & (here > disparity)
            disparity[seen] = here[seen]
            image[seen] = colour_of(number, column, row)[seen]
        assert np.isfinite(disparity).all()
        views.append(ArrayView(f"m{m:g}n{n:g}", image, LatticePosition(m, n)))
        occluded = np.zeros(shape, np.bool_)
        surfaces.append(Surface(disparity.astype(np.float32), occluded, np.ones(shape, np.float32)))
    return Reconstruction(CameraArray(tuple(views)), labels, tuple(surfaces))


def square_lattice(reach: int) -> list[tuple[float, float]]:
    """Return the positions of (2 reach + 1)^2 cameras, those nearest to the centre first."""
    numbers = range(-reach, reach + 1)
    positions = [(float(m), float(n)) for n in numbers for m in numbers]
    return sorted(positions, key=lambda place: (abs(place[0]) + abs(place[1]), place))


LABELS = DisparityLabels(0.0, 1.0, 12)
BACKGROUND, TABLE, LAMP = Plane(2.0), Plane(6.0, (16, 48), (12, 32)), Plane(10.0, (26, 34), (4, 24))
SCENE = (BACKGROUND, TABLE, LAMP)
"""Three planes one before the other."""
