"""Sprites with depth as a folder: of each its picture, disparity and depth, and `sprites.json`.

The format is described in docs/layers.md.
"""

from pathlib import Path

import numpy as np

from dvc.errors import DvcError
from dvc.index_files import Entry, read_index, write_index
from dvc.layers.canvas import Canvas
from dvc.layers.canvas_files import canvas_values, read_canvas, read_disparity
from dvc.layers.sprites import Sprite, SpriteSet
from dvc.pfm import write_pfm
from dvc.picture_files import read_plane, write_png

INDEX = "sprites.json"
FORMAT, VERSION = "dvc3d sprites", 1
MAX_SPRITES = 1 << 16


def write_sprites(folder: Path, sprites: SpriteSet) -> None:
    """Write sprites; inverse of `read_sprites`."""
    scale = sprites.canvas.depth_scale
    entries = []
    for number, sprite in enumerate(sprites.sprites):
        names = {
            "colour": f"sprite-{number:04d}.png",
            "disparity": f"disparity-{number:04d}.pfm",
            "depth": f"depth-{number:04d}.pfm",
        }
        opaque = np.dstack([sprite.colour[:, :, ::-1], sprite.mask * np.uint8(255)])
        write_png(folder / names["colour"], opaque)
        disparity = np.where(sprite.mask, sprite.disparity, np.float32(np.inf))
        write_pfm(folder / names["disparity"], disparity)
        depth = np.full(disparity.shape, np.inf, np.float32)
        depth[sprite.mask] = scale.depth(sprite.disparity[sprite.mask])
        write_pfm(folder / names["depth"], depth)
        height, width = sprite.mask.shape
        place = {"left": sprite.left, "top": sprite.top, "width": width, "height": height}
        entries.append({**place, "num_values": sprite.num_values, **names})
    write_index(folder / INDEX, FORMAT, VERSION, {**canvas_values(sprites.canvas), "sprites": entries})


def read_sprites(folder: str | Path) -> SpriteSet:
    """Read a folder that `write_sprites` has written."""
    index = read_index(Path(folder) / INDEX, FORMAT, VERSION, "dvc-stereo sprites")
    canvas = read_canvas(index)
    entries = index.entries("sprites", MAX_SPRITES)
    return SpriteSet(canvas, tuple(_read_sprite(entry, canvas) for entry in entries))


def _read_sprite(entry: Entry, canvas: Canvas) -> Sprite:
    left, top = entry.integer("left", 0, canvas.shape[1] - 1), entry.integer("top", 0, canvas.shape[0] - 1)
    width = entry.integer("width", 1, canvas.shape[1] - left)
    height = entry.integer("height", 1, canvas.shape[0] - top)
    colour = read_plane(entry.file("colour"), 4, (height, width))
    mask = colour[:, :, 3] > 0
    if not np.array_equal(colour[:, :, 3], mask * np.uint8(255)):
        raise DvcError(f"{entry.file('colour')}: opacity is neither 0 nor 255")
    disparity = read_disparity(entry.file("disparity"), mask)
    if entry.integer("num_values", 0, width * height) != np.count_nonzero(mask):
        entry.refuse("'num_values' is not the number of opaque pixels")
    return Sprite(left, top, mask, colour[:, :, :3] * mask[..., None], disparity)
