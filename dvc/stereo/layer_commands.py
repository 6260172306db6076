"""Subcommands `dvc-stereo layers` and `dvc-stereo sprites`, with their pictures (BGR) and pages."""

import argparse
from pathlib import Path

import cv2
import numpy as np

from dvc import cli
from dvc.arrays import Bytes, Mask, Singles
from dvc.errors import ConfigError
from dvc.files import atomic_folder
from dvc.layers.canvas import Canvas
from dvc.layers.layer_folders import read_layers, write_layers, write_sprites
from dvc.layers.layered_depth_image import LayeredDepthImage, layered_depth_image
from dvc.layers.sprites import SpriteSet, composite, extract_sprites
from dvc.picture_files import write_png
from dvc.stereo.evaluation import write_results
from dvc.stereo.meshes import check_outputs, scene_shape, write_shape
from dvc.stereo.surfaces.surface_folder import INDEX, read_reconstruction
from dvc.web.drawing import Picture, colour_counts, colour_disparity, in_rows, with_title
from dvc.web.gallery import PAGE, Gallery, Group, Shown, Table, write_gallery

PAPER = np.array([200, 120, 200], np.uint8)
"""Colour of empty pixels, which surfaces rarely have."""
WHITE_VALUES = 3
"""Number of values that is white in the picture of values per pixel."""
TILE_PX = 400
MAX_MAGNIFICATION = 4.0
SHOWN_SPRITES = 40
"""Number of sprites on the page, the largest first."""


def draw_layers(image: LayeredDepthImage) -> Picture:
    """Draw textures and disparities of all layers, as figure 2.6."""
    textures, disparities = [], []
    for number, mask in enumerate(image.occupied):
        texture = _textured(image.colour[number], mask)
        textures.append(with_title(texture, f"layer {number + 1}: {np.count_nonzero(mask)} values"))
        disparities.append(_coloured(image.disparity[number], mask, image.canvas))
    return in_rows([*textures, *disparities], len(textures))


def draw_values_per_pixel(image: LayeredDepthImage) -> Picture:
    """Draw the number of values of pixels, as figure 2.10: black none, white three or more."""
    return colour_counts(image.values_per_pixel, WHITE_VALUES)


def draw_sprites(sprites: SpriteSet, count: int = 24, columns: int = 4) -> Picture:
    """Draw the largest sprites, each scaled to its tile, as figure 2.7."""
    largest = sorted(sprites.sprites, key=lambda sprite: -sprite.num_values)[:count]
    tiles = []
    for sprite in largest:
        texture = _textured(sprite.colour, sprite.mask)
        pair = np.hstack([texture, _coloured(sprite.disparity, sprite.mask, sprites.canvas)])
        scale = min(TILE_PX / pair.shape[1], TILE_PX / 2 / pair.shape[0], MAX_MAGNIFICATION)
        size = max(1, round(scale * pair.shape[1])), max(1, round(scale * pair.shape[0]))
        method = cv2.INTER_NEAREST if scale > 1.0 else cv2.INTER_AREA
        tile = np.full((TILE_PX // 2, TILE_PX, 3), 255, np.uint8)
        tile[: size[1], : size[0]] = cv2.resize(pair, size, interpolation=method)
        tiles.append(with_title(tile, f"{sprite.num_values} values, {scale:.1f}x"))
    return in_rows(tiles, columns)


def _textured(colour: Bytes, mask: Mask) -> Picture:
    return np.where(mask[..., None], colour[:, :, ::-1], PAPER)


def _coloured(disparity: Singles, mask: Mask, canvas: Canvas) -> Picture:
    coloured = colour_disparity(disparity, canvas.labels.lowest, canvas.labels.highest)
    return np.where(mask[..., None], coloured, PAPER)


def run_layers(arguments: argparse.Namespace) -> int:
    """Write the layered depth image of a reconstruction."""
    meshes = check_outputs(arguments, [arguments.path])
    image = _merged_layers(arguments)
    canvas, counts = image.canvas, image.counts()
    white = min(canvas.num_cameras, 255)
    groups = []
    for number, mask in enumerate(image.occupied):
        shown = (
            Shown("texture", _textured(image.colour[number], mask)),
            Shown("disparity", _coloured(image.disparity[number], mask, canvas), "near is bright"),
            Shown("votes", colour_counts(image.votes[number], white), "white: all cameras"),
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
    gallery = Gallery("Layered depth image", preface, groups, [table])
    with atomic_folder(arguments.out) as folder:
        write_layers(folder, image)
        write_png(folder / "preview-layers.png", draw_layers(image))
        write_png(folder / "preview-values.png", draw_values_per_pixel(image))
        write_gallery(folder / PAGE, gallery)
    for path in meshes:
        write_shape(path, scene_shape(image))
    text = (
        f"{counts['num_layers']} layers of {canvas.num_cameras} views: "
        f"{counts['num_values_inside']} values in the frame of {canvas.reference} "
        f"({counts['increase_percent']:+.1f} %), "
        f"{counts['num_values_beyond']} beyond it"
    )
    write_results(arguments.json, counts, "" if arguments.quiet else text)
    return 0


def _merged_layers(arguments: argparse.Namespace) -> LayeredDepthImage:
    """Merge the surfaces of a reconstruction."""
    reconstruction = read_reconstruction(arguments.path)
    with cli.progress_bar("layers", len(reconstruction.array), arguments.quiet) as advance:
        return layered_depth_image(reconstruction, advance=advance)


def run_sprites(arguments: argparse.Namespace) -> int:
    """Write the sprites of a layered depth image or of a reconstruction."""
    meshes = check_outputs(arguments, [arguments.path])
    is_reconstruction = (Path(arguments.path) / INDEX).is_file()
    image = _merged_layers(arguments) if is_reconstruction else read_layers(arguments.path)
    if not image.occupied.any():
        raise ConfigError(f"{arguments.path}: the layers have no values")
    with cli.progress_bar("sprites", int(image.occupied.sum()), arguments.quiet) as advance:
        sprites = extract_sprites(image, advance=advance)
    largest = sorted(enumerate(sprites.sprites), key=lambda entry: -entry[1].num_values)[:SHOWN_SPRITES]
    groups = []
    for number, sprite in largest:
        shown = (
            Shown("texture", _textured(sprite.colour, sprite.mask), f"{sprite.num_values} values"),
            Shown("disparity", _coloured(sprite.disparity, sprite.mask, sprites.canvas), "near is bright"),
        )
        groups.append(Group(f"sprite {number}", shown))
    preface = f"{len(sprites.sprites)} sprites of the frame of {sprites.canvas.reference}, the largest first."
    gallery = Gallery("Sprites with depth", preface, groups)
    with atomic_folder(arguments.out) as folder:
        write_sprites(folder, sprites)
        write_png(folder / "preview-sprites.png", draw_sprites(sprites))
        write_gallery(folder / PAGE, gallery)
    for path in meshes:
        write_shape(path, scene_shape(sprites))
    frame = image.canvas.frame.slices
    colour, _, mask = composite(sprites)
    first = image.colour[0] * image.occupied[0][..., None]
    sizes = sorted((sprite.num_values for sprite in sprites.sprites), reverse=True)
    counts = {
        "num_sprites": len(sizes),
        "num_values": sum(sizes),
        "num_values_of_layers": int(image.occupied.sum()),
        "gives_reference_back": bool(
            np.array_equal(colour[frame], first[frame])
            and np.array_equal(mask[frame], image.occupied[0][frame])
        ),
        "num_values_by_sprite": sizes,
    }
    text = f"{counts['num_sprites']} sprites of {counts['num_values']} values"
    write_results(arguments.json, counts, "" if arguments.quiet else text)
    return 0
