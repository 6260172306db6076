"""Sprites with depth (2.22): a layered depth image cut into regions without discontinuities.

Choices that the thesis leaves open:

* A difference of depth, ``scale / (disparity + shift)`` (2.12), counts relative to its resolution; this ratio
  is ``|z - z'| / sqrt(r r') = |d - d'| / r_d``, so differences of disparity are compared.
* Differences up to half of `resolution` are smooth, above one and a half discontinuities, in between small.
* A sprite begins as the largest region of a watershed, in the first layer, of the distance to
  pixels that are not smooth.
* The likelihoods are beliefs: a pixel sends each neighbour the transition of its belief without the message
  of that neighbour; messages multiply their odds. They run outwards from the sprite and back until they
  converge, over all pixels that can be reached from it without a discontinuity.
* Scattered pixels that remain without a region of `min_values` form one last sprite for each layer.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, no-check-untyped-defs

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel
from dvc.arrays import Bytes, Floats, Integers, Mask, Singles
from dvc.layers.canvas import Canvas
from dvc.layers.layered_depth_image import LayeredDepthImage

SMOOTH, JUMP = 0.5, 1.5
"""Largest smooth difference and smallest discontinuity, in units of resolution."""
_NOTHING = -(2**40)
MAX_SWEEPS = 100
TOLERANCE = 1e-4
"""Largest change of converged messages."""


class SpriteSettings(NamedTuple):
    """Settings for cutting a layered depth image.

    Attributes
    ----------
    rho_smooth, rho_small : float
        Transition likelihoods of (2.22) on smooth surfaces, and at small differences:
        0 <= rho_smooth < rho_small <= 1/2.
    peak_distance_px : int
        Smallest distance between two centres of regions of the watershed.
    min_values : int
        Smallest initial region of a sprite, in values.
    space : str
        Compared quantity: ``disparity``, or ``depth`` with the resolution at the median disparity.
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
        Opaque pixels.
    colour : ndarray of shape (h, w, 3), uint8
        Red, green and blue; 0 outside the mask.
    disparity : ndarray of shape (h, w), float32
        In pixels per unit of m; 0 outside the mask.
    """

    left: int
    top: int
    mask: Mask
    colour: Bytes
    disparity: Singles

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
        Their canvas.
    sprites : tuple of Sprite
        In the order of their extraction; each value of the image is in exactly one.
    """

    canvas: Canvas
    sprites: tuple[Sprite, ...]


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
        Image to cut.
    settings : SpriteSettings, optional
        Settings.
    advance : callable, optional
        Called with the number of values of each new sprite.

    Returns
    -------
    SpriteSet
        The sprites.
    """
    values = image.disparity.astype(np.float64)
    if settings.space == "depth":  # negative (2.12), scaled to change like disparities at the median
        scale, shift = image.canvas.depth_scale
        median = float(np.median(image.disparity[image.occupied])) if image.occupied.any() else 1.0
        disparity = np.where(image.occupied, image.disparity, np.float32(median)).astype(np.float64)
        values = -(scale / (disparity + shift)) * (median + shift) ** 2 / scale
    depth, alpha = values / image.canvas.resolution, image.occupied.copy()
    source, sprites = np.indices(alpha.shape)[0], []
    while alpha[0].any():
        region = _largest_region(depth[0], alpha[0], settings)
        is_small = np.count_nonzero(region) < settings.min_values
        layer = np.where(alpha[0], 0, -1) if is_small else _grow(depth, alpha, region, settings)
        taken = np.full(layer.shape, -1)
        for index in range(len(alpha)):  # values behind the sprite move forward
            rows, columns = np.nonzero(layer == index)
            taken[rows, columns] = source[index, rows, columns]
            for rest in (depth, alpha, source):
                rest[index:-1, rows, columns] = rest[index + 1 :, rows, columns]
            alpha[-1, rows, columns] = False
        sprites.append(_cut(image, taken))
        advance(sprites[-1].num_values)
    return SpriteSet(image.canvas, tuple(sprites))


def _largest_region(depth: Floats, alpha: Mask, settings: SpriteSettings) -> Mask:
    """Return the largest region of a watershed between the edges of a layer."""
    from skimage.feature import peak_local_max
    from skimage.measure import label as label_components
    from skimage.segmentation import watershed

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
    """Return the mask of the most frequent number from 1 on."""
    sizes = np.bincount(regions.ravel(), minlength=2)[1:]
    return np.asarray(regions == 1 + sizes.argmax())


def _grow(depth: Floats, alpha: Mask, mask: Mask, settings: SpriteSettings) -> Integers:
    """Return the layer of each pixel of a sprite that begins with a mask in the first layer, -1 elsewhere."""
    layer = np.where(mask, 0, -1)
    surface = np.where(mask, depth[0], 0.0)
    unchanged, index = 0, 0
    while unchanged < len(alpha):
        added = fused_mask(surface, layer >= 0, depth[index], alpha[index], settings) & (layer < 0)
        layer[added] = index
        surface[added] = depth[index][added]
        unchanged = 0 if added.any() else unchanged + 1
        index = (index + 1) % len(alpha)
    return layer


def fused_mask(
    depth: Floats,
    alpha: Mask,
    layer_depth: Floats,
    layer_alpha: Mask,
    settings: SpriteSettings = DEFAULT_SETTINGS,
) -> Mask:
    """Fuse a sprite with a layer by (2.22), and infer which pixels belong to the sprite."""
    fused_alpha = alpha | layer_alpha
    fused_depth = np.where(alpha, depth, layer_depth)
    order, entered = np.empty(alpha.size, np.int64), np.zeros(alpha.shape, np.bool_)
    count = _reach(fused_depth, fused_alpha, alpha, JUMP, order, entered)
    if count == np.count_nonzero(alpha):
        return alpha
    _reach(fused_depth, entered, alpha, np.inf, order, np.zeros_like(entered))
    messages = np.full((*alpha.shape, 4), 0.5)
    rho = settings.rho_smooth, settings.rho_small
    likelihood = _likelihood(fused_depth, alpha, entered, order[:count], *rho, messages)
    return np.asarray(likelihood > 0.5)


@kernel
def _reach(depth, alpha, mask, jump, order, entered):
    """List the pixels that can be reached from those of a mask without a discontinuity, the mask's first."""
    height, width = depth.shape
    count = 0
    for y in range(height):
        for x in range(width):
            if mask[y, x]:
                order[count] = y * width + x
                entered[y, x] = True
                count += 1
    done = 0
    while done < count:
        y, x = order[done] // width, order[done] % width
        done += 1
        for side in range(4):
            v, u = _neighbour(y, x, side)
            if not (0 <= v < height and 0 <= u < width) or entered[v, u] or not alpha[v, u]:
                continue
            if abs(depth[v, u] - depth[y, x]) <= jump:
                entered[v, u] = True
                order[count] = v * width + u
                count += 1
    return count


@kernel
def _neighbour(y, x, side):
    """Return the neighbour to the right, below, to the left or above; (s + 2) % 4 is opposite to side s."""
    return y + int(side == 1) - int(side == 3), x + int(side == 0) - int(side == 2)


@kernel
def _likelihood(depth, mask, entered, order, rho_smooth, rho_small, messages):
    """Pass messages of (2.22) forth and back along `order`, and return the likelihoods."""
    height, width = depth.shape
    first = 0
    while first < order.size and mask[order[first] // width, order[first] % width]:
        _send(order[first], depth, mask, entered, rho_smooth, rho_small, messages)
        first += 1
    for sweep in range(MAX_SWEEPS):
        change = 0.0
        for k in range(first, order.size):
            pixel = order[k] if sweep % 2 == 0 else order[order.size - 1 - (k - first)]
            change = max(change, _send(pixel, depth, mask, entered, rho_smooth, rho_small, messages))
        if change < TOLERANCE:
            break
    result = np.zeros((height, width))
    for pixel in order:
        y, x = pixel // width, pixel % width
        result[y, x] = 1.0 if mask[y, x] else _belief(messages[y, x], -1)
    return result


@kernel
def _send(pixel, depth, mask, entered, rho_smooth, rho_small, messages):
    """Send the messages of a pixel, and return their largest change."""
    height, width = depth.shape
    y, x = pixel // width, pixel % width
    change = 0.0
    for side in range(4):
        v, u = _neighbour(y, x, side)
        if not (0 <= v < height and 0 <= u < width) or not entered[v, u] or mask[v, u]:
            continue
        p = 1.0 if mask[y, x] else _belief(messages[y, x], side)
        difference = abs(depth[v, u] - depth[y, x])
        if difference <= SMOOTH:
            sent = (1.0 - 2.0 * rho_smooth) * p + rho_smooth
        elif difference <= JUMP:
            sent = (1.0 - 2.0 * rho_small) * p + rho_small
        else:
            sent = min(1.0 - p, 0.5)
        opposite = (side + 2) % 4
        change = max(change, abs(sent - messages[v, u, opposite]))
        messages[v, u, opposite] = sent
    return change


@kernel
def _belief(messages, excluded):
    """Return the likelihood from independent messages, except that of one side."""
    yes, no = 1.0, 1.0
    for side in range(4):
        if side != excluded:
            yes, no = yes * messages[side], no * (1.0 - messages[side])
    return yes / (yes + no) if yes + no > 0.0 else 0.5


def _cut(image: LayeredDepthImage, layer: Integers) -> Sprite:
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


def composite(sprites: SpriteSet) -> tuple[Bytes, Singles, Mask]:
    """Draw all sprites on the canvas, the nearest on top."""
    colour = np.zeros((*sprites.canvas.shape, 3), np.uint8)
    disparity, mask = np.zeros(sprites.canvas.shape, np.float32), np.zeros(sprites.canvas.shape, np.bool_)
    for sprite in sprites.sprites:
        window = sprite.slices
        nearer = sprite.mask & (~mask[window] | (sprite.disparity > disparity[window]))
        colour[window][nearer] = sprite.colour[nearer]
        disparity[window][nearer] = sprite.disparity[nearer]
        mask[window][nearer] = True
    return colour, disparity, mask
