"""Hole filling: what no picture shows takes up the background around it, by the Poisson equation.

A hole opens between a near surface that has moved and a far one that it no longer covers, along the
epipolar line. Its pixels belong to the far one: levels are those of a membrane spanned over the hole from the
background alone, free at the near surface. Beside the frame of what was seen there is no such pair, and all
that surrounds it bounds it.

References
----------
[Perez2003] P. Pérez, M. Gangnet, A. Blake, "Poisson image editing", ACM Trans. Graph. 22(3), 2003.
"""

import numpy as np
from numpy.typing import NDArray

from dvc.geometry import _kernels
from dvc.geometry.rendering import EMPTY, fill_holes

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

STIFFNESS = 1e-6
"""Pull of the nearest level, against 1 of each neighbour: holes that nothing bounds have a solution, too."""
TOLERANCE = 1e-4
"""Root mean square of what is left of the equations, in levels."""


def fill_from_background(image: Floats, inverse_depth: Floats, epipole: Floats) -> tuple[Floats, Floats]:
    """Fill the holes of a rendered picture."""
    holes = inverse_depth <= EMPTY
    if not holes.any():
        return image, inverse_depth
    if holes.all():
        return np.zeros_like(image), np.zeros_like(inverse_depth)
    far, near = np.empty_like(inverse_depth), np.empty_like(inverse_depth)
    _kernels.along_epipolar_lines(inverse_depth, np.ascontiguousarray(epipole), far, near)
    rows, columns = np.empty((2, *holes.shape), np.int64)
    _kernels.nearest_drawn(holes, rows, columns)
    guess = image[rows, columns]
    filled = image.copy()
    filled[holes] = _membrane(image, holes, inverse_depth, 0.5 * (far + near), guess)
    return filled, fill_holes(far)


def _membrane(image: Floats, holes: Mask, depth: Floats, limit: Floats, guess: Floats) -> Floats:
    """Levels (K, C) of the K pixels of holes; what is drawn nearer than the limit does not bound them."""
    number = np.full(holes.shape, -1, np.int32)
    count = int(holes.sum())
    number[holes] = np.arange(count, dtype=np.int32)
    neighbours, diagonal = np.empty((count, 4), np.int32), np.empty(count)
    levels = np.ascontiguousarray(guess[holes].T)
    right = STIFFNESS * levels
    _kernels.membrane_equations(number, depth, limit, image, STIFFNESS, neighbours, diagonal, right)
    for channel, target in zip(levels, right, strict=True):
        _kernels.solve_membrane(neighbours, diagonal, target, TOLERANCE, channel)
    return levels.T


def poisson_filled(image: Floats, holes: Mask) -> Floats:
    """Fill holes from all that surrounds them, near or far."""
    if not holes.any() or holes.all():
        return image
    rows, columns = np.empty((2, *holes.shape), np.int64)
    _kernels.nearest_drawn(holes, rows, columns)
    flat = np.where(holes, EMPTY, 0.0)
    filled = image.copy()
    filled[holes] = _membrane(image, holes, flat, np.full(holes.shape, np.inf), image[rows, columns])
    return filled
