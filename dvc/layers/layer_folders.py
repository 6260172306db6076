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
    values = {**canvas_values(image.canvas), "layers": entries}
    write_index(folder / LAYERS_INDEX, LAYERS_FORMAT, VERSION, values)


def read_layers(folder: str | Path) -> LayeredDepthImage:
    """Read a folder of `write_layers`."""
    index = read_index(Path(folder) / LAYERS_INDEX, LAYERS_FORMAT, VERSION, "dvc-stereo layers")
    canvas = read_canvas(index)
    entries = index.entries("layers", MAX_LAYERS)
    parts = []
    for entry in entries:
        picture, opacity = _read_colour(entry, canvas.shape)
        votes = read_plane(entry.file("votes"), 1, canvas.shape)
        if not np.array_equal(opacity, votes > 0):
            expected = "opacity must be 255 at pixels with votes and 0 at other pixels"
            raise DvcError(f"{entry.file('colour')}: {expected}")
        parts.append((picture, read_disparity(entry.file("disparity"), opacity), votes))
    stacked: list[Any] = [np.stack(part) for part in zip(*parts, strict=True)]
    colour, disparity, votes = stacked
    occupied = votes > 0
    behind = occupied[1:]
    if (behind & ~occupied[:-1]).any() or (behind & (disparity[1:] >= disparity[:-1])).any():
        index.refuse("layers do not lie behind each other")
    return LayeredDepthImage(canvas, colour, disparity, votes)


def write_sprites(folder: Path, sprites: SpriteSet) -> None:
    """Write sprites; inverse of `read_sprites`."""
    scale = sprites.canvas.depth_scale
    entries = []
    for number, sprite in enumerate(sprites.sprites):
        names = {"colour": f"sprite-{number:04d}.png"}
        names |= {kind: f"{kind}-{number:04d}.pfm" for kind in ("disparity", "depth")}
        _write_values(folder, names, sprite.colour, sprite.disparity, sprite.mask)
        depth = np.full(sprite.mask.shape, np.inf, np.float32)
        depth[sprite.mask] = scale.depth(sprite.disparity[sprite.mask])
        write_pfm(folder / names["depth"], depth)
        height, width = sprite.mask.shape
        window = {"left": sprite.left, "top": sprite.top, "width": width, "height": height}
        entries.append({**window, "num_values": sprite.num_values, **names})
    values = {**canvas_values(sprites.canvas), "sprites": entries}
    write_index(folder / SPRITES_INDEX, SPRITES_FORMAT, VERSION, values)


def read_sprites(folder: str | Path) -> SpriteSet:
    """Read a folder of `write_sprites`."""
    index = read_index(Path(folder) / SPRITES_INDEX, SPRITES_FORMAT, VERSION, "dvc-stereo sprites")
    canvas = read_canvas(index)
    sprites = []
    for entry in index.entries("sprites", MAX_SPRITES):
        left, top, width, height = _read_frame(entry, canvas.shape)
        colour, mask = _read_colour(entry, (height, width))
        if entry.integer("num_values", 0, width * height) != np.count_nonzero(mask):
            entry.refuse("'num_values' is not the number of opaque pixels")
        sprites.append(Sprite(left, top, mask, colour, read_disparity(entry.file("disparity"), mask)))
    return SpriteSet(canvas, tuple(sprites))


def _read_frame(entry: Entry, shape: tuple[int, int]) -> Frame:
    left, top = entry.integer("left", 0, shape[1] - 1), entry.integer("top", 0, shape[0] - 1)
    return Frame(
        left, top, entry.integer("width", 1, shape[1] - left), entry.integer("height", 1, shape[0] - top)
    )


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
    frame = _read_frame(index.entry("frame"), shape)
    labels = read_labels(index.entry("disparities"))
    matrix = None if index.value("world_from_rectified") is None else index.matrix("world_from_rectified", 4)
    if matrix is not None and matrix[3, 2] == 0.0:
        index.refuse("'world_from_rectified' gives no depth")
    resolution, reference = index.number("resolution", 0.0), index.text("reference")
    num_cameras = index.integer("num_cameras", 1, 1 << 15)
    return Canvas(shape, frame, labels, resolution, reference, num_cameras, matrix)


def read_disparity(path: Path, mask: Mask) -> Singles:
    """Read disparities that are defined inside a mask and infinite outside it."""
    disparity = read_pfm(path)
    if disparity.shape != mask.shape:
        (height, width), expected = disparity.shape, mask.shape
        raise DvcError(f"{path}: {width}x{height}, expected {expected[1]}x{expected[0]}")
    if not np.array_equal(np.abs(disparity) <= MAX_NUMBER, mask) or not (disparity[~mask] == np.inf).all():
        raise DvcError(f"{path}: values must be finite inside the picture, and infinite outside it")
    return np.where(mask, disparity, np.float32(0.0))
