"""Sprites with depth (2.22): a layered depth image cut into regions without discontinuities.

Readings of what the thesis leaves open:

* Sprites are sought in depth, which is ``scale / (disparity + shift)`` in a rectified space (2.12). A
  difference of depth counts by how finely depth is resolved there, and for any such depth this ratio is
  ``|z - z'| / sqrt(r r') = |d - d'| / r_d``, with resolutions r, r' of the depths and r_d of the disparity:
  differences of disparity are compared, and neither scale nor shift matter. Or depths themselves are, in
  units of their resolution at the median.
* Up to half of `resolution` is smooth, above one and a half is a discontinuity, between is a small
  difference.
* A sprite begins as the largest region of a watershed, in the first layer, of the distance to what is not
  smooth.
* The likelihoods are the beliefs of message passing. A pixel sends each neighbour the transition of its
  belief without what that neighbour has told it; messages combine as independent ones do, by the product of
  their odds. They run outwards from the sprite and back until they do not change, over all that can be
  reached from it without a discontinuity. It is deterministic.
* What is left when no region of `min_values` is, scattered pixels, makes one last sprite a layer: remnants.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.feature import peak_local_max
from skimage.measure import label as label_components
from skimage.segmentation import watershed

from dvc.layers import _kernels
from dvc.layers.canvas import Canvas
from dvc.layers.layered_depth_image import LayeredDepthImage

Mask = NDArray[np.bool_]

SMOOTH, JUMP = 0.5, 1.5
"""Differences up to the one are smooth, above the other are discontinuities; in units of resolution."""
_NOTHING = -(2**40)
MAX_SWEEPS = 100
TOLERANCE = 1e-4
"""Messages that change by less have converged."""


class SpriteSettings(NamedTuple):
    """How a layered depth image is cut.

    Attributes
    ----------
    rho_smooth, rho_small : float
        Transition likelihoods of (2.22) where the surface is smooth, and at small differences:
        0 <= rho_smooth < rho_small <= 1/2.
    peak_distance_px : int
        Least distance between two centres of regions of the watershed.
    min_values : int
        A sprite begins with at least this many values.
    space : str
        What is compared: ``disparity``, or ``depth``, whose resolution is that of the median disparity
        everywhere.
    """

    rho_smooth: float = 0.2
    rho_small: float = 0.49
    peak_distance_px: int = 8
    min_values: int = 16
    space: str = "disparity"


DEFAULT_SETTINGS = SpriteSettings()


@dataclass(frozen=True, eq=False)
class Sprite:
    """A surface without discontinuities.

    Attributes
    ----------
    left, top : int
        Column and row of its first pixel in the canvas.
    mask : ndarray of shape (h, w), bool
        Where it is opaque.
    colour : ndarray of shape (h, w, 3), uint8
        Red, green and blue; 0 outside the mask.
    disparity : ndarray of shape (h, w), float32
        In pixels per unit of m; 0 outside the mask.
    """

    left: int
    top: int
    mask: Mask
    colour: NDArray[np.uint8]
    disparity: NDArray[np.float32]

    @property
    def num_values(self) -> int:
        """Number of its pixels."""
        return int(self.mask.sum())

    @property
    def slices(self) -> tuple[slice, slice]:
        """Its rows and columns in the canvas."""
        height, width = self.mask.shape
        return slice(self.top, self.top + height), slice(self.left, self.left + width)


@dataclass(frozen=True, eq=False)
class SpriteSet:
    """All sprites of a layered depth image.

    Attributes
    ----------
    canvas : Canvas
        Where they are.
    sprites : tuple of Sprite
        In the order of their extraction; each value of the image is in exactly one.
    """

    canvas: Canvas
    sprites: tuple[Sprite, ...]


class _Layers:
    """What is left of a layered depth image, with disparities, or depths, in units of resolution."""

    def __init__(self, image: LayeredDepthImage, space: str) -> None:
        values = _depths(image) if space == "depth" else image.disparity.astype(np.float64)
        self.depth = values / image.canvas.resolution
        self.alpha = image.occupied.copy()
        self.source = np.broadcast_to(np.arange(len(self.alpha))[:, None, None], self.alpha.shape).copy()

    def take(self, layer: NDArray[np.int64]) -> NDArray[np.int64]:
        """Take the value in a layer (-1: none) of each pixel away, and move those behind it forward."""
        taken = np.full(layer.shape, -1)
        for index in range(len(self.alpha)):
            rows, columns = np.nonzero(layer == index)
            taken[rows, columns] = self.source[index, rows, columns]
            for values in (self.depth, self.alpha, self.source):
                values[index:-1, rows, columns] = values[index + 1 :, rows, columns]
            self.alpha[-1, rows, columns] = False
        return taken


def _depths(image: LayeredDepthImage) -> NDArray[np.float64]:
    """Return depths (2.12) behind a minus, scaled so that at the median they change as disparities do."""
    scale, shift = image.canvas.depth_scale
    median = float(np.median(image.disparity[image.occupied])) if image.occupied.any() else 1.0
    disparity = np.where(image.occupied, image.disparity, np.float32(median)).astype(np.float64)
    return -(scale / (disparity + shift)) * (median + shift) ** 2 / scale


def extract_sprites(
    image: LayeredDepthImage,
    settings: SpriteSettings = DEFAULT_SETTINGS,
    *,
    advance: Callable[[int], None] = lambda _: None,
) -> SpriteSet:
    """Cut a layered depth image into sprites; each of its values is in exactly one of them.

    Parameters
    ----------
    image : LayeredDepthImage
        What to cut.
    settings : SpriteSettings, optional
        How.
    advance : callable, optional
        Told the number of values that have just been put into a sprite.

    Returns
    -------
    SpriteSet
        The sprites.
    """
    layers = _Layers(image, settings.space)
    sprites = []
    while layers.alpha[0].any():
        region = _largest_region(layers.depth[0], layers.alpha[0], settings)
        if np.count_nonzero(region) < settings.min_values:
            layer = np.where(layers.alpha[0], 0, -1)
        else:
            layer = _grow(layers, region, settings)
        sprites.append(_cut(image, layers.take(layer)))
        advance(sprites[-1].num_values)
    return SpriteSet(image.canvas, tuple(sprites))


def _largest_region(depth: NDArray[np.float64], alpha: Mask, settings: SpriteSettings) -> Mask:
    """Return the largest region of a watershed between the edges of a layer."""
    edge = ~alpha
    for axis in (0, 1):
        step = np.abs(np.diff(depth, axis=axis)) > SMOOTH
        before, after = (np.s_[:-1], np.s_[1:]) if axis == 0 else (np.s_[:, :-1], np.s_[:, 1:])
        edge[before] |= step
        edge[after] |= step
    distance = cv2.distanceTransform(
        (~np.pad(edge, 1, constant_values=True)).astype(np.uint8), cv2.DIST_L2, 5
    )
    distance = distance[1:-1, 1:-1]
    peaks = peak_local_max(distance, min_distance=settings.peak_distance_px, exclude_border=False)
    markers = np.zeros(alpha.shape, np.int32)
    markers[peaks[:, 0], peaks[:, 1]] = np.arange(1, len(peaks) + 1)
    region = _largest(watershed(-distance, markers, mask=~edge))
    if np.count_nonzero(region) >= settings.min_values:
        return region
    nearest = np.where(alpha, np.rint(depth).astype(np.int64), _NOTHING)
    return _largest(label_components(nearest, background=_NOTHING, connectivity=1))


def _largest(regions: NDArray[np.integer]) -> Mask:
    """Return where the number from 1 on is that appears most often."""
    sizes = np.bincount(regions.ravel(), minlength=2)[1:]
    return np.asarray(regions == 1 + sizes.argmax())


def _grow(layers: _Layers, mask: Mask, settings: SpriteSettings) -> NDArray[np.int64]:
    """Return the layer of each pixel of a sprite that begins with a mask in the first layer, -1 elsewhere."""
    layer = np.where(mask, 0, -1)
    depth = np.where(mask, layers.depth[0], 0.0)
    unchanged, index = 0, 0
    while unchanged < len(layers.alpha):
        added = fused_mask(depth, layer >= 0, layers.depth[index], layers.alpha[index], settings) & (
            layer < 0
        )
        layer[added] = index
        depth[added] = layers.depth[index][added]
        unchanged = 0 if added.any() else unchanged + 1
        index = (index + 1) % len(layers.alpha)
    return layer


def fused_mask(
    depth: NDArray[np.float64],
    alpha: Mask,
    layer_depth: NDArray[np.float64],
    layer_alpha: Mask,
    settings: SpriteSettings = DEFAULT_SETTINGS,
) -> Mask:
    """Fuse a sprite with a layer by (2.22), and infer which pixels belong to the sprite."""
    fused_alpha = alpha | layer_alpha
    fused_depth = np.where(alpha, depth, layer_depth)
    order, entered = np.empty(alpha.size, np.int64), np.zeros(alpha.shape, np.bool_)
    count = _kernels.reach(fused_depth, fused_alpha, alpha, JUMP, order, entered)
    if count == np.count_nonzero(alpha):
        return alpha
    _kernels.reach(fused_depth, entered, alpha, np.inf, order, np.zeros_like(entered))
    messages = np.full((*alpha.shape, 4), 0.5)
    rho = settings.rho_smooth, settings.rho_small
    order = order[:count]
    transitions = _kernels.Transitions(SMOOTH, JUMP, rho)
    likelihood = _kernels.likelihood(
        fused_depth, alpha, entered, order, transitions, MAX_SWEEPS, TOLERANCE, messages
    )
    return np.asarray(likelihood > 0.5)


def _cut(image: LayeredDepthImage, layer: NDArray[np.int64]) -> Sprite:
    """Return a sprite of the values in a layer of each pixel, -1: none."""
    mask = layer >= 0
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    top, left = int(rows[0]), int(columns[0])
    window = np.s_[top : rows[-1] + 1, left : columns[-1] + 1]
    mask = mask[window]
    chosen = np.maximum(layer[window], 0)[None]
    disparity = np.take_along_axis(image.disparity[:, *window], chosen, axis=0)[0]
    colour = np.take_along_axis(image.colour[:, *window], chosen[..., None], axis=0)[0]
    return Sprite(left, top, mask, colour * mask[..., None], disparity * mask)


def composite(sprites: SpriteSet) -> tuple[NDArray[np.uint8], NDArray[np.float32], Mask]:
    """Draw all sprites on the canvas, the nearest on top."""
    colour = np.zeros((*sprites.canvas.shape, 3), np.uint8)
    disparity, mask = np.zeros(sprites.canvas.shape, np.float32), np.zeros(sprites.canvas.shape, np.bool_)
    for sprite in sprites.sprites:
        place = sprite.slices
        nearer = sprite.mask & (~mask[place] | (sprite.disparity > disparity[place]))
        colour[place][nearer] = sprite.colour[nearer]
        disparity[place][nearer] = sprite.disparity[nearer]
        mask[place][nearer] = True
    return colour, disparity, mask
