"""A layered depth image as a folder: of each layer colour, disparity and votes, and `layers.json`.

The format is described in docs/layers.md.
"""

from pathlib import Path

import numpy as np

from dvc.errors import DvcError
from dvc.index_files import Entry, read_index, write_index
from dvc.layers.canvas import Canvas
from dvc.layers.canvas_files import canvas_values, read_canvas, read_disparity
from dvc.layers.layered_depth_image import MAX_LAYERS, LayeredDepthImage
from dvc.pfm import write_pfm
from dvc.picture_files import read_plane, write_png

INDEX = "layers.json"
FORMAT, VERSION = "dvc3d layers", 1


def write_layers(folder: Path, image: LayeredDepthImage) -> None:
    """Write a layered depth image; inverse of `read_layers`."""
    entries = []
    for layer, mask in enumerate(image.occupied):
        names = {
            "colour": f"colour-{layer}.png",
            "disparity": f"disparity-{layer}.pfm",
            "votes": f"votes-{layer}.png",
        }
        opaque = np.dstack([image.colour[layer][:, :, ::-1] * mask[..., None], mask * np.uint8(255)])
        write_png(folder / names["colour"], opaque)
        disparity = np.where(mask, image.disparity[layer], np.float32(np.inf))
        write_pfm(folder / names["disparity"], disparity)
        write_png(folder / names["votes"], image.votes[layer])
        entries.append(names)
    write_index(folder / INDEX, FORMAT, VERSION, {**canvas_values(image.canvas), "layers": entries})


def read_layers(folder: str | Path) -> LayeredDepthImage:
    """Read a folder that `write_layers` has written."""
    index = read_index(Path(folder) / INDEX, FORMAT, VERSION, "dvc-stereo layers")
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
    colour = read_plane(entry.file("colour"), 4, canvas.shape)
    votes = read_plane(entry.file("votes"), 1, canvas.shape)
    mask = votes > 0
    if not np.array_equal(colour[:, :, 3], mask * np.uint8(255)):
        raise DvcError(f"{entry.file('colour')}: opacity is not 255 where there are votes and 0 elsewhere")
    disparity = read_disparity(entry.file("disparity"), mask)
    return colour[:, :, :3] * mask[..., None], disparity, votes
