"""Folders of layers and of sprites: pictures and disparities, and an index with the canvas.

docs/stereo.md describes the format.
"""

from pathlib import Path
from typing import Any

import numpy as np

from dvc.array_files import MAX_NUMBER
from dvc.arrays import Bytes, Mask, Singles
from dvc.errors import DvcError
from dvc.index_files import Entry, read_index, read_labels, write_index
from dvc.layers.canvas import Canvas, Frame
from dvc.layers.layered_depth_image import MAX_LAYERS, LayeredDepthImage
from dvc.layers.sprites import Sprite, SpriteSet
from dvc.picture_files import read_pfm, read_plane, write_pfm, write_png

LAYERS_INDEX, SPRITES_INDEX = "layers.json", "sprites.json"
LAYERS_FORMAT, SPRITES_FORMAT = "dvc3d layers", "dvc3d sprites"
VERSION = 1
MAX_SPRITES = 1 << 16


def write_layers(folder: Path, image: LayeredDepthImage) -> None:
    """Write a layered depth image; inverse of `read_layers`."""
    entries = []
    for layer, mask in enumerate(image.occupied):
        kinds = {"colour": "png", "disparity": "pfm", "votes": "png"}
        names = {kind: f"{kind}-{layer}.{suffix}" for kind, suffix in kinds.items()}
        colour = image.colour[layer] * mask[..., None]
        _write_values(folder, names, colour, image.disparity[layer], mask)
        write_png(folder / names["votes"], image.votes[layer])
        entries.append(names)
    write_index(
        folder / LAYERS_INDEX, LAYERS_FORMAT, VERSION, {**canvas_values(image.canvas), "layers": entries}
    )


def read_layers(folder: str | Path) -> LayeredDepthImage:
    """Read a folder of `write_layers`."""
    index = read_index(Path(folder) / LAYERS_INDEX, LAYERS_FORMAT, VERSION, "dvc-stereo layers")
    canvas = read_canvas(index)
    entries = index.entries("layers", MAX_LAYERS)
    parts = [_read_layer(entry, canvas) for entry in entries]
    colour, disparity, votes = (np.stack([part[kind] for part in parts]) for kind in range(3))
    occupied = votes > 0
    behind = occupied[1:]
    if (behind & ~occupied[:-1]).any() or (behind & (disparity[1:] >= disparity[:-1])).any():
        index.refuse("layers do not lie behind each other")
    return LayeredDepthImage(canvas, colour, disparity, votes)


def _read_layer(entry: Entry, canvas: Canvas) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    colour, opacity = _read_colour(entry, canvas.shape)
    votes = read_plane(entry.file("votes"), 1, canvas.shape)
    mask = votes > 0
    if not np.array_equal(opacity, mask):
        raise DvcError(
            f"{entry.file('colour')}: opacity must be 255 at pixels with votes and 0 at other pixels"
        )
    return colour, read_disparity(entry.file("disparity"), mask), votes


def write_sprites(folder: Path, sprites: SpriteSet) -> None:
    """Write sprites; inverse of `read_sprites`."""
    scale = sprites.canvas.depth_scale
    entries = []
    for number, sprite in enumerate(sprites.sprites):
        kinds = {
            "colour": "sprite-{:04d}.png",
            "disparity": "disparity-{:04d}.pfm",
            "depth": "depth-{:04d}.pfm",
        }
        names = {kind: name.format(number) for kind, name in kinds.items()}
        _write_values(folder, names, sprite.colour, sprite.disparity, sprite.mask)
        depth = np.full(sprite.mask.shape, np.inf, np.float32)
        depth[sprite.mask] = scale.depth(sprite.disparity[sprite.mask])
        write_pfm(folder / names["depth"], depth)
        height, width = sprite.mask.shape
        window = {"left": sprite.left, "top": sprite.top, "width": width, "height": height}
        entries.append({**window, "num_values": sprite.num_values, **names})
    write_index(
        folder / SPRITES_INDEX, SPRITES_FORMAT, VERSION, {**canvas_values(sprites.canvas), "sprites": entries}
    )


def read_sprites(folder: str | Path) -> SpriteSet:
    """Read a folder of `write_sprites`."""
    index = read_index(Path(folder) / SPRITES_INDEX, SPRITES_FORMAT, VERSION, "dvc-stereo sprites")
    canvas = read_canvas(index)
    entries = index.entries("sprites", MAX_SPRITES)
    return SpriteSet(canvas, tuple(_read_sprite(entry, canvas) for entry in entries))


def _read_sprite(entry: Entry, canvas: Canvas) -> Sprite:
    left, top = entry.integer("left", 0, canvas.shape[1] - 1), entry.integer("top", 0, canvas.shape[0] - 1)
    width = entry.integer("width", 1, canvas.shape[1] - left)
    height = entry.integer("height", 1, canvas.shape[0] - top)
    colour, mask = _read_colour(entry, (height, width))
    disparity = read_disparity(entry.file("disparity"), mask)
    if entry.integer("num_values", 0, width * height) != np.count_nonzero(mask):
        entry.refuse("'num_values' is not the number of opaque pixels")
    return Sprite(left, top, mask, colour, disparity)


def _write_values(folder: Path, names: dict[str, str], colour: Bytes, disparity: Singles, mask: Mask) -> None:
    """Write colour with opacity, and disparity that is infinite outside a mask."""
    write_png(folder / names["colour"], np.dstack([colour[:, :, ::-1], mask * np.uint8(255)]))
    write_pfm(folder / names["disparity"], np.where(mask, disparity, np.float32(np.inf)))


def _read_colour(entry: Entry, shape: tuple[int, int]) -> tuple[Bytes, Mask]:
    """Read colour, black outside a mask, and the mask from its opacity."""
    colour = read_plane(entry.file("colour"), 4, shape)
    mask = colour[:, :, 3] > 0
    if not np.array_equal(colour[:, :, 3], mask * np.uint8(255)):
        raise DvcError(f"{entry.file('colour')}: opacity is neither 0 nor 255")
    return colour[:, :, :3] * mask[..., None], mask


def canvas_values(canvas: Canvas) -> dict[str, Any]:
    """Return the values of an index file for a canvas; inverse of `read_canvas`."""
    homography = canvas.world_from_rectified
    return {
        "width": canvas.shape[1],
        "height": canvas.shape[0],
        "frame": canvas.frame._asdict(),
        "disparities": canvas.labels._asdict(),
        "resolution": canvas.resolution,
        "reference": canvas.reference,
        "num_cameras": canvas.num_cameras,
        "world_from_rectified": None if homography is None else homography.tolist(),
        "depth": canvas.depth_scale._asdict(),
    }


def read_canvas(index: Entry) -> Canvas:
    """Read a canvas from an index file; inverse of `canvas_values`."""
    shape = index.shape()
    inner = index.entry("frame")
    left, top = inner.integer("left", 0, shape[1] - 1), inner.integer("top", 0, shape[0] - 1)
    width, height = inner.integer("width", 1, shape[1] - left), inner.integer("height", 1, shape[0] - top)
    labels = read_labels(index.entry("disparities"))
    matrix = None if index.value("world_from_rectified") is None else index.matrix("world_from_rectified", 4)
    if matrix is not None and matrix[3, 2] == 0.0:
        index.refuse("'world_from_rectified' gives no depth")
    return Canvas(
        shape,
        Frame(left, top, width, height),
        labels,
        index.number("resolution", 0.0),
        index.text("reference"),
        index.integer("num_cameras", 1, 1 << 15),
        matrix,
    )


def read_disparity(path: Path, mask: Mask) -> Singles:
    """Read disparities that are defined inside a mask and infinite outside it."""
    disparity = read_pfm(path)
    if disparity.shape != mask.shape:
        (height, width), expected = disparity.shape, mask.shape
        raise DvcError(f"{path}: {width}x{height}, expected {expected[1]}x{expected[0]}")
    if not np.array_equal(np.abs(disparity) <= MAX_NUMBER, mask) or not (disparity[~mask] == np.inf).all():
        raise DvcError(f"{path}: values must be finite inside the picture, and infinite outside it")
    return np.where(mask, disparity, np.float32(0.0))
