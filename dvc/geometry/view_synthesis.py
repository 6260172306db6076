"""View synthesis: the picture of another view from pictures with depth, and what none of them shows.

Surfaces are drawn forward with depth order, so that near ones cover far ones; every pixel that they reach
then fetches its levels from between the pixels of the source. What is left continues the background.

References
----------
[Maitre2008] Sec. 3.2: several pictures with depth in one stream; (3.4): forward compensation.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.hole_filling import fill_from_background
from dvc.geometry.rendering import EMPTY, draw
from dvc.geometry.sampling import sample
from dvc.geometry.warping import inverse_warp, warp_grid

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

DISCONTINUITY_PX = 1.5
"""Neighbours whose motions differ by more may belong to different surfaces."""
SAME_SURFACE_PX = 1.0
"""Largest parallax between what two sources show of one surface."""
FALLBACK_WEIGHT = 1e-6
"""Weight, relative to 1, of sources that are shown where no other one sees anything."""


class PictureWithDepth(NamedTuple):
    """A picture with the depth of its pixels, and where the wanted view lies."""

    image: NDArray[np.uint8]  # the picture
    inverse_depth: Floats  # of its pixels; disparity in rectified arrays. `EMPTY` where there is nothing
    warp: Floats  # to the wanted view, in pixels; see `dvc.geometry.warping`
    # inverse depth between neighbours of one surface is at most this, whatever the motion: the precision with
    # which it is known
    step: float = 0.0
    # share in what several pictures show; with 0, shown only where no other one sees anything
    weight: float = 1.0


class SynthesisedView(NamedTuple):
    """A picture that no camera has taken."""

    image: Floats  # levels from 0 to 255, without holes
    inverse_depth: Floats  # in the wanted view, without holes
    drawn: Mask  # what a source shows; the rest is filled


Surface = Callable[[Sequence[PictureWithDepth], Sequence[Floats]], Floats]
"""Chooses the inverse depth of a view from what each source shows in it."""


def nearest_surface(sources: Sequence[PictureWithDepth], drawn: Sequence[Floats]) -> Floats:
    """Choose the nearest of what sources show."""
    nearest: Floats = np.maximum.reduce(drawn)
    return nearest


def agreed_surface(sources: Sequence[PictureWithDepth], drawn: Sequence[Floats]) -> Floats:
    """Choose what sources of most weight show: a wrong depth of one does not cover what others see."""
    backs = [inverse_warp(source.warp) for source in sources]
    chosen, most = np.full(drawn[0].shape, EMPTY), np.zeros(drawn[0].shape)
    for own in drawn:
        votes = np.zeros(own.shape)
        for source, back, other in zip(sources, backs, drawn, strict=True):
            both = (own > EMPTY) & (other > EMPTY)
            same = _parallax_px(back, np.where(both, own, 0.0), np.where(both, other, 0.0)) <= SAME_SURFACE_PX
            votes += np.where(both & same, max(source.weight, FALLBACK_WEIGHT), 0.0)
        better = (votes > most) | ((votes == most) & (own > chosen))
        chosen, most = np.where(better, own, chosen), np.where(better, votes, most)
    return chosen


def _parallax_px(warp: Floats, own: Floats, other: Floats) -> Floats:
    """Measure how far apart points of two depths lie in another view."""
    apart = warp_grid(warp, own)[..., :2] - warp_grid(warp, other)[..., :2]
    return np.asarray(np.hypot(apart[..., 0], apart[..., 1]))


def synthesise(
    sources: Sequence[PictureWithDepth], shape: tuple[int, int], surface: Surface = nearest_surface
) -> SynthesisedView:
    """Render a view."""
    drawn = [drawn_depth(source, shape) for source in sources]
    nearest = surface(sources, drawn)
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
    """Return what a source shows in the wanted view."""
    depth = source.inverse_depth
    missing = [(0, max(2 - size, 0)) for size in depth.shape]  # a cell has four corners
    depth = np.pad(depth, missing, mode="edge") if any(pad for _, pad in missing) else depth
    nearest = np.full(shape, EMPTY)
    jumps = _discontinuities(depth, source.warp, source.step)
    draw(depth, source.warp, jumps, np.ones(jumps.shape, dtype=bool), nearest)
    return nearest


def _discontinuities(depth: Floats, warp: Floats, step: float) -> Mask:
    """Cells whose corners belong to different surfaces."""
    x_and_y = warp_grid(warp, depth)[..., :2]
    flat = warp_grid(warp, np.full(depth.shape, depth.min(where=depth > EMPTY, initial=np.inf)))[..., :2]
    found: Mask = (_spread(x_and_y - flat).max(axis=-1) > DISCONTINUITY_PX) & (_spread(depth) > 1.5 * step)
    return found | (_spread(depth) >= -0.5 * EMPTY)


def _spread(plane: Floats) -> Floats:
    """Largest difference between the four corners of each cell."""
    sides = plane[:, :-1], plane[:, 1:]
    most, least = np.maximum(*sides), np.minimum(*sides)
    return np.asarray(np.maximum(most[:-1], most[1:]) - np.minimum(least[:-1], least[1:]))
