"""Subcommands `dvc-stereo layers` and `dvc-stereo sprites`."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from dvc import cli
from dvc.errors import ConfigError
from dvc.files import atomic_folder
from dvc.layers.layer_folders import read_layers, write_layers, write_sprites
from dvc.layers.layered_depth_image import LayeredDepthImage, layered_depth_image
from dvc.layers.sprites import SpriteSet, composite, extract_sprites
from dvc.picture_files import write_png
from dvc.stereo.layer_pictures import (
    PAGE,
    draw_layers,
    draw_sprites,
    draw_values_per_pixel,
    layers_gallery,
    sprites_gallery,
)
from dvc.stereo.meshes import layers_shape, sprites_shape, write_shape
from dvc.stereo.stereo_options import check_outputs, write_results
from dvc.stereo.surfaces.surface_folder import INDEX, read_reconstruction
from dvc.web.gallery import write_gallery


def run_layers(arguments: argparse.Namespace) -> int:
    """Write the layered depth image of a reconstruction."""
    meshes = check_outputs(arguments, [arguments.path])
    image = _merged_layers(arguments)
    with atomic_folder(arguments.out) as folder:
        write_layers(folder, image)
        write_png(folder / "preview-layers.png", draw_layers(image))
        write_png(folder / "preview-values.png", draw_values_per_pixel(image))
        write_gallery(folder / PAGE, layers_gallery(image))
    for path in meshes:
        write_shape(path, layers_shape(image))
    counts, canvas = image.counts(), image.canvas
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
    with atomic_folder(arguments.out) as folder:
        write_sprites(folder, sprites)
        write_png(folder / "preview-sprites.png", draw_sprites(sprites))
        write_gallery(folder / PAGE, sprites_gallery(sprites))
    for path in meshes:
        write_shape(path, sprites_shape(sprites))
    counts = _sprite_counts(image, sprites)
    text = f"{counts['num_sprites']} sprites of {counts['num_values']} values"
    write_results(arguments.json, counts, "" if arguments.quiet else text)
    return 0


def _sprite_counts(image: LayeredDepthImage, sprites: SpriteSet) -> dict[str, Any]:
    frame = image.canvas.frame.slices
    colour, _, mask = composite(sprites)
    first = image.colour[0] * image.occupied[0][..., None]
    sizes = sorted((sprite.num_values for sprite in sprites.sprites), reverse=True)
    return {
        "num_sprites": len(sizes),
        "num_values": sum(sizes),
        "num_values_of_layers": int(image.occupied.sum()),
        "gives_reference_back": bool(
            np.array_equal(colour[frame], first[frame])
            and np.array_equal(mask[frame], image.occupied[0][frame])
        ),
        "num_values_by_sprite": sizes,
    }
