"""Pages that show layers and sprites."""

import numpy as np
from numpy.typing import NDArray

from dvc.layers.layered_depth_image import LayeredDepthImage
from dvc.layers.sprites import SpriteSet
from dvc.stereo.output.layer_pictures import PAPER, draw_values_per_pixel
from dvc.web.drawing import Picture, colour_counts, colour_disparity
from dvc.web.gallery import Gallery, Group, Shown, Table

PAGE = "index.html"
MOST_SPRITES = 40
"""Larger ones first; the others are in the folder."""


def layers_gallery(image: LayeredDepthImage) -> Gallery:
    """Make the page of a layered depth image."""
    canvas, counts = image.canvas, image.counts()
    groups = []
    for number, mask in enumerate(image.occupied):
        shown = (
            Shown("texture", _textured(image.colour[number], mask)),
            Shown("disparity", _coloured(image.disparity[number], mask, image), "near is bright"),
            Shown(
                "votes",
                colour_counts(image.votes[number], min(canvas.num_cameras, 255)),
                "white: all cameras",
            ),
        )
        groups.append(Group(f"layer {number + 1}", shown))
    values = Shown("values per pixel", draw_values_per_pixel(image), "black none, white three or more")
    groups.append(Group("all layers", (values,)))
    by_layer = zip(counts["num_values_by_layer"], image.occupied, strict=True)
    rows = tuple(
        (f"layer {number}", str(inside), str(int(np.count_nonzero(mask)) - inside))
        for number, (inside, mask) in enumerate(by_layer, start=1)
    )
    caption = f"Values inside the frame of {canvas.reference}, and beyond it"
    preface = (
        f"{canvas.num_cameras} views merged in the frame of {canvas.reference}: "
        f"{counts['increase_percent']:+.1f} % more values inside it than one disparity map has."
    )
    table = Table("Values", caption, ("layer", "inside", "beyond"), rows)
    return Gallery("Layered depth image", preface, groups, [table])


def sprites_gallery(sprites: SpriteSet) -> Gallery:
    """Make the page of sprites."""
    labels = sprites.canvas.labels
    largest = sorted(enumerate(sprites.sprites), key=lambda entry: -entry[1].num_values)[:MOST_SPRITES]
    groups = []
    for number, sprite in largest:
        disparity = colour_disparity(sprite.disparity, labels.lowest, labels.highest)
        shown = (
            Shown("texture", _textured(sprite.colour, sprite.mask), f"{sprite.num_values} values"),
            Shown("disparity", _on_paper(disparity, sprite.mask), "near is bright"),
        )
        groups.append(Group(f"sprite {number}", shown))
    preface = f"{len(sprites.sprites)} sprites of the frame of {sprites.canvas.reference}, the largest first."
    return Gallery("Sprites with depth", preface, groups)


def _coloured(disparity: NDArray[np.float32], mask: NDArray[np.bool_], image: LayeredDepthImage) -> Picture:
    labels = image.canvas.labels
    return _on_paper(colour_disparity(disparity, labels.lowest, labels.highest), mask)


def _textured(colour: NDArray[np.uint8], mask: NDArray[np.bool_]) -> Picture:
    return _on_paper(colour[:, :, ::-1], mask)


def _on_paper(picture: Picture, mask: NDArray[np.bool_]) -> Picture:
    return np.where(mask[..., None], picture, PAPER)
