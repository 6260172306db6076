"""`dvc-stereo sprites`: a layered depth image cut into sprites with depth."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.errors import ConfigError
from dvc.stereo.commands.layers import add_output_options
from dvc.stereo.commands.options import check_outputs

if TYPE_CHECKING:
    from dvc.layers.layered_depth_image import LayeredDepthImage
    from dvc.layers.sprites import SpriteSet

SUMMARY = "sprites with depth from layers"
EXAMPLES = """\
  dvc-stereo layers surfaces --out layers
  dvc-stereo sprites layers --out sprites
  dvc-stereo sprites surfaces --out sprites --json - --glb sprites.glb
"""
DESCRIPTION = """\
Cut the layered depth image of a scene into surfaces without discontinuities. docs/layers.md describes the
files.
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    written = "folder that `dvc-stereo layers` or `dvc-stereo reconstruct` has written"
    parser.add_argument("path", metavar="DIR", help=written)
    add_output_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Cut."""
    import sys

    from dvc.files import atomic_folder
    from dvc.layers.sprites import extract_sprites
    from dvc.layers.sprites_folder import write_sprites
    from dvc.picture_files import write_png
    from dvc.stereo.output.export import write_shape
    from dvc.stereo.output.layer_meshes import sprites_shape
    from dvc.stereo.output.layer_page import PAGE, sprites_gallery
    from dvc.stereo.output.layer_pictures import draw_sprites
    from dvc.web.gallery import write_gallery

    meshes = check_outputs(arguments, [arguments.path])
    image = _read(Path(arguments.path), arguments.quiet)
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
    counts = _counts(image, sprites)
    if arguments.json is not None:
        cli.write_json(arguments.json, counts)
    if arguments.json != "-" and not arguments.quiet:
        sys.stdout.write(f"{counts['num_sprites']} sprites of {counts['num_values']} values\n")
    return 0


def _read(path: Path, quiet: bool) -> "LayeredDepthImage":
    from dvc.layers import layers_folder
    from dvc.layers.layered_depth_image import layered_depth_image
    from dvc.stereo.surfaces import folder

    if not (path / folder.INDEX).is_file():
        return layers_folder.read_layers(path)
    reconstruction = folder.read_reconstruction(path)
    with cli.progress_bar("layers", len(reconstruction.array), quiet) as advance:
        return layered_depth_image(reconstruction, advance=advance)


def _counts(image: "LayeredDepthImage", sprites: "SpriteSet") -> dict[str, Any]:
    import numpy as np

    from dvc.layers.sprites import composite

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
