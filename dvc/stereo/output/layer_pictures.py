"""Pictures of layers and sprites, in blue, green and red: figures 2.6, 2.7, 2.10 and 2.11."""

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.layers.canvas import Canvas
from dvc.layers.layered_depth_image import LayeredDepthImage
from dvc.layers.sprites import Sprite, SpriteSet
from dvc.web.drawing import colour_counts, colour_disparity, in_rows, with_title

Picture = NDArray[np.uint8]
Window = tuple[slice, slice]

PAPER = np.array([200, 120, 200], np.uint8)
"""Where there is nothing: a colour that surfaces rarely have."""
MOST_VALUES = 3
"""What is white in the picture of values per pixel."""
TILE_PX = 400
MOST_MAGNIFIED = 4.0


def draw_layers(image: LayeredDepthImage) -> Picture:
    """Draw textures and disparities of all layers, as figure 2.6."""
    textures, disparities = [], []
    for number, mask in enumerate(image.occupied):
        texture = np.where(mask[..., None], image.colour[number][:, :, ::-1], PAPER)
        textures.append(with_title(texture, f"layer {number + 1}: {np.count_nonzero(mask)} values"))
        disparities.append(_coloured(image.disparity[number], mask, image.canvas))
    return in_rows([*textures, *disparities], len(textures))


def draw_values_per_pixel(image: LayeredDepthImage) -> Picture:
    """Draw how many values pixels have, as figure 2.10: black none, white three or more."""
    return colour_counts(image.values_per_pixel, MOST_VALUES)


def draw_surfaces(image: LayeredDepthImage, lowest: float, highest: float, window: Window) -> Picture:
    """Draw what lies in a range of disparity, whatever is before it, as figure 2.11."""
    frame, shape = image.canvas.frame, image.canvas.shape
    rows = np.arange(window[0].start, window[0].stop) + frame.top
    columns = np.arange(window[1].start, window[1].stop) + frame.left
    kept = image.occupied & (image.disparity >= lowest) & (image.disparity <= highest)
    picture = np.broadcast_to(PAPER, (*shape, 3)).copy()
    for colour, mask in zip(image.colour[::-1], kept[::-1], strict=True):
        picture[mask] = colour[mask][:, ::-1]
    inside = ((rows >= 0) & (rows < shape[0]))[:, None] & ((columns >= 0) & (columns < shape[1]))
    cut = picture[np.clip(rows, 0, shape[0] - 1)[:, None], np.clip(columns, 0, shape[1] - 1)]
    return np.where(inside[..., None], cut, PAPER)


def draw_sprites(sprites: SpriteSet, most: int = 24, columns: int = 4) -> Picture:
    """Draw the largest sprites, each as large as a tile allows, as figure 2.7."""
    largest = sorted(sprites.sprites, key=lambda sprite: -sprite.num_values)[:most]
    return in_rows([_draw_sprite(sprite, sprites.canvas) for sprite in largest], columns)


def _draw_sprite(sprite: Sprite, canvas: Canvas) -> Picture:
    texture = np.where(sprite.mask[..., None], sprite.colour[:, :, ::-1], PAPER)
    disparity = _coloured(sprite.disparity, sprite.mask, canvas)
    pair = np.hstack([texture, disparity])
    scale = min(TILE_PX / pair.shape[1], TILE_PX / 2 / pair.shape[0], MOST_MAGNIFIED)
    size = max(1, round(scale * pair.shape[1])), max(1, round(scale * pair.shape[0]))
    method = cv2.INTER_NEAREST if scale > 1.0 else cv2.INTER_AREA
    tile = np.full((TILE_PX // 2, TILE_PX, 3), 255, np.uint8)
    tile[: size[1], : size[0]] = cv2.resize(pair, size, interpolation=method)
    return with_title(tile, f"{sprite.num_values} values, {scale:.1f}x")


def _coloured(disparity: NDArray[np.float32], mask: NDArray[np.bool_], canvas: Canvas) -> Picture:
    picture = colour_disparity(disparity, canvas.labels.lowest, canvas.labels.highest)
    return np.where(mask[..., None], picture, PAPER)
