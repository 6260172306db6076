"""View synthesis: the picture of another view from pictures with depth, and the filling of its holes.

Surfaces are drawn forward in depth order (3.4); every pixel that they reach then fetches its levels from
between the pixels of the source. A hole between a near surface and a far one, along the epipolar line,
belongs to the far one: its levels are a membrane (the Poisson equation, [Perez2003]) that is fixed to the
background and free at the near surface. Holes at the border of the frame are fixed to all around them.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dvc._jit import kernel
from dvc.arrays import Bytes, Floats, Mask
from dvc.geometry.rendering import draw, fill_holes
from dvc.geometry.warping import EMPTY, inverse_warp, sample, warp_grid

DISCONTINUITY_PX = 1.5
"""Largest difference of motion between neighbours that certainly belong to one surface."""
SAME_SURFACE_PX = 1.0
"""Largest parallax between two sources of one surface."""
FALLBACK_WEIGHT = 1e-6
"""Weight, relative to 1, of sources that only fill gaps of the other ones."""
STIFFNESS = 1e-6
"""Pull of the nearest level, relative to 1 of each neighbour: unbounded holes have a solution, too."""
TOLERANCE = 1e-4
"""Root mean square of the residual of the equations, in levels."""


class PictureWithDepth(NamedTuple):
    """A picture with the depth of its pixels, and its warp to the target view."""

    image: Bytes
    inverse_depth: Floats  # disparity in rectified arrays; `EMPTY` for pixels without a surface
    warp: Floats  # to the target view, in pixels; see `dvc.geometry.warping`
    # precision of the inverse depth: smaller steps are no discontinuity, however large the motion
    step: float = 0.0
    # weight among several sources; 0 for sources that only fill gaps of the other ones
    weight: float = 1.0


class SynthesisedView(NamedTuple):
    """A synthesised picture."""

    image: Floats  # levels from 0 to 255, without holes
    inverse_depth: Floats  # in the target view, without holes
    drawn: Mask  # pixels from a source; the rest is filled


def synthesise(
    sources: Sequence[PictureWithDepth], shape: tuple[int, int], surface: Floats | None = None
) -> SynthesisedView:
    """Render the target view of some sources, at the nearest depth of all or at that of a surface."""
    drawn = [drawn_depth(source, shape) for source in sources]
    nearest = np.maximum.reduce(drawn) if surface is None else surface
    total = np.zeros(shape)
    image = np.zeros((*shape, sources[0].image.shape[2]))
    for source, depth in zip(sources, drawn, strict=True):
        seen = depth > EMPTY
        if not seen.any():
            continue
        back = inverse_warp(source.warp)
        positions = warp_grid(back, np.where(seen, depth, 0.0))
        if len(sources) > 1:
            before = warp_grid(back, np.where(seen, nearest, 0.0))
            parallax = np.hypot(*(positions - before)[..., :2].transpose(2, 0, 1))
            seen &= parallax <= SAME_SURFACE_PX
        weights = np.where(seen, max(source.weight, FALLBACK_WEIGHT), 0.0)
        planes = (np.ascontiguousarray(plane) for plane in source.image.transpose(2, 0, 1))
        image += weights[..., None] * np.stack([sample(plane, positions) for plane in planes], axis=-1)
        total += weights
    reached = total > 0.0
    image[reached] /= total[reached][:, None]
    epipole = max(sources, key=lambda source: source.weight).warp[:, 3]
    filled, inverse_depth = fill_from_background(image, np.where(reached, nearest, EMPTY), epipole)
    return SynthesisedView(filled, inverse_depth, reached)


def drawn_depth(source: PictureWithDepth, shape: tuple[int, int]) -> Floats:
    """Return the inverse depth of a source in the target view."""
    depth = source.inverse_depth
    missing = [(0, max(2 - size, 0)) for size in depth.shape]  # a cell has four corners
    depth = np.pad(depth, missing, mode="edge") if any(pad for _, pad in missing) else depth
    flat = np.full(depth.shape, depth.min(where=depth > EMPTY, initial=np.inf))
    motion = (warp_grid(source.warp, depth) - warp_grid(source.warp, flat))[..., :2]
    spread = _spread(depth)
    jumps = (_spread(motion).max(axis=-1) > DISCONTINUITY_PX) & (spread > 1.5 * source.step)
    jumps |= spread >= -0.5 * EMPTY
    nearest = np.full(shape, EMPTY)
    draw(depth, source.warp, jumps, np.ones(jumps.shape, dtype=bool), nearest)
    return nearest


def _spread(plane: Floats) -> Floats:
    """Return the largest difference between the four corners of each cell."""
    sides = plane[:, :-1], plane[:, 1:]
    most, least = np.maximum(*sides), np.minimum(*sides)
    return np.asarray(np.maximum(most[:-1], most[1:]) - np.minimum(least[:-1], least[1:]))


def fill_from_background(image: Floats, inverse_depth: Floats, epipole: Floats) -> tuple[Floats, Floats]:
    """Fill the holes of a rendered picture from the background around them."""
    from scipy.ndimage import distance_transform_edt

    holes = inverse_depth <= EMPTY
    if not holes.any():
        return image, inverse_depth
    if holes.all():
        return np.zeros_like(image), np.zeros_like(inverse_depth)
    far, near = _along_epipolar_lines(inverse_depth, np.ascontiguousarray(epipole))
    rows, columns = distance_transform_edt(holes, return_distances=False, return_indices=True)
    number, count = np.full(holes.shape, -1, np.int32), int(holes.sum())
    number[holes] = np.arange(count, dtype=np.int32)
    neighbours, diagonal = np.empty((count, 4), np.int32), np.empty(count)
    levels = np.ascontiguousarray(image[rows[holes], columns[holes]].T)
    right, limit = STIFFNESS * levels, 0.5 * (far + near)
    _membrane_equations(number, inverse_depth, limit, image, neighbours, diagonal, right)
    for channel, target in zip(levels, right, strict=True):
        _solve_membrane(neighbours, diagonal, target, channel)
    filled = image.copy()
    filled[holes] = levels.T
    return filled, fill_holes(far)


@kernel
def _along_epipolar_lines(depth, epipole):
    """Return the farthest and nearest depth at both ends of the epipolar line through each hole."""
    height, width = depth.shape
    far, near = np.empty_like(depth), np.empty_like(depth)
    for y in range(height):
        for x in range(width):
            if depth[y, x] > EMPTY:
                far[y, x] = near[y, x] = depth[y, x]
                continue
            dx, dy = epipole[0] - x * epipole[2], epipole[1] - y * epipole[2]
            length = max(abs(dx), abs(dy))
            ends = 0
            for side in (-1.0, 1.0):
                k = 0
                while length > 0.0:
                    k += 1
                    i = int(np.floor(y + side * k * dy / length + 0.5))
                    j = int(np.floor(x + side * k * dx / length + 0.5))
                    if not (0 <= i < height and 0 <= j < width):
                        break
                    if depth[i, j] > EMPTY:
                        far[y, x] = min(far[y, x], depth[i, j]) if ends else depth[i, j]
                        near[y, x] = max(near[y, x], depth[i, j]) if ends else depth[i, j]
                        ends += 1
                        break
            if ends == 0:
                far[y, x] = near[y, x] = EMPTY
            if ends < 2:
                near[y, x] = np.inf
    return far, near


@kernel
def _membrane_equations(number, depth, limit, image, neighbours, diagonal, right):
    """Set up the Laplace equation in holes; surfaces nearer than the limit do not bound them."""
    height, width = number.shape
    for y in range(height):
        for x in range(width):
            row = number[y, x]
            if row < 0:
                continue
            diagonal[row] = STIFFNESS
            for side in range(4):
                i = y + (-1 if side == 0 else 1 if side == 1 else 0)
                j = x + (-1 if side == 2 else 1 if side == 3 else 0)
                neighbours[row, side] = -1
                if not (0 <= i < height and 0 <= j < width):
                    continue
                if number[i, j] >= 0:
                    neighbours[row, side] = number[i, j]
                    diagonal[row] += 1.0
                elif depth[i, j] <= limit[y, x]:
                    diagonal[row] += 1.0
                    for c in range(image.shape[2]):
                        right[c, row] += image[i, j, c]


@kernel
def _solve_membrane(neighbours, diagonal, right, levels):
    """Solve the equations of one channel by conjugate gradients, from approximate levels."""
    product = np.empty_like(levels)
    _membrane_product(neighbours, diagonal, levels, product)
    residual = right - product
    direction = residual.copy()
    squared = float((residual * residual).sum())
    limit = TOLERANCE * TOLERANCE * levels.shape[0]
    for _ in range(10 * levels.shape[0]):
        if squared <= limit:
            break
        step = squared / _membrane_product(neighbours, diagonal, direction, product)
        before, squared = squared, 0.0
        for row in range(levels.shape[0]):
            levels[row] += step * direction[row]
            residual[row] -= step * product[row]
            squared += residual[row] * residual[row]
        share = squared / before
        for row in range(levels.shape[0]):
            direction[row] = residual[row] + share * direction[row]


@kernel
def _membrane_product(neighbours, diagonal, levels, product):
    """Multiply levels by the matrix of the equations; return the product of the result and the levels."""
    form = 0.0
    for row in range(levels.shape[0]):
        total = diagonal[row] * levels[row]
        for side in range(4):
            column = neighbours[row, side]
            if column >= 0:
                total -= levels[column]
        product[row] = total
        form += levels[row] * total
    return form
