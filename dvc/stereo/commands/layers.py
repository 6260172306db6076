"""`dvc-stereo layers`: a layered depth image from the surfaces of all views."""

import argparse
from typing import TYPE_CHECKING

from dvc import cli
from dvc.stereo.commands.options import add_export_options, check_outputs

if TYPE_CHECKING:
    from dvc.layers.layered_depth_image import LayeredDepthImage

SUMMARY = "layered depth image from surfaces"
EXAMPLES = """\
  dvc-stereo reconstruct left.png right.png --disparities 0:60 --out surfaces
  dvc-stereo layers surfaces --out layers
  dvc-stereo layers surfaces --out layers --json counts.json --glb layers.glb
"""
DESCRIPTION = """\
Merge the surfaces of all views in the frame of the view nearest to (0, 0): several values of disparity and
colour a pixel, from near to far. docs/layers.md describes the files.
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("path", metavar="DIR", help="folder that `dvc-stereo reconstruct` has written")
    add_output_options(parser)


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what is written."""
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write, new or empty")
    parser.add_argument("--json", metavar="FILE", help="write the counts; - is standard output")
    add_export_options(parser)
    parser.add_argument("--quiet", action="store_true", help="show no progress and print no summary")


def run(arguments: argparse.Namespace) -> int:
    """Merge."""
    import sys

    from dvc.files import atomic_folder
    from dvc.layers.layered_depth_image import layered_depth_image
    from dvc.layers.layers_folder import write_layers
    from dvc.picture_files import write_png
    from dvc.stereo.output.export import write_shape
    from dvc.stereo.output.layer_meshes import layers_shape
    from dvc.stereo.output.layer_page import PAGE, layers_gallery
    from dvc.stereo.output.layer_pictures import draw_layers, draw_values_per_pixel
    from dvc.stereo.surfaces.folder import read_reconstruction
    from dvc.web.gallery import write_gallery

    meshes = check_outputs(arguments, [arguments.path])
    reconstruction = read_reconstruction(arguments.path)
    with cli.progress_bar("layers", len(reconstruction.array), arguments.quiet) as advance:
        image = layered_depth_image(reconstruction, advance=advance)
    with atomic_folder(arguments.out) as folder:
        write_layers(folder, image)
        write_png(folder / "preview-layers.png", draw_layers(image))
        write_png(folder / "preview-values.png", draw_values_per_pixel(image))
        write_gallery(folder / PAGE, layers_gallery(image))
    for path in meshes:
        write_shape(path, layers_shape(image))
    if arguments.json is not None:
        cli.write_json(arguments.json, image.counts())
    if arguments.json != "-" and not arguments.quiet:
        sys.stdout.write(counts_text(image) + "\n")
    return 0


def counts_text(image: "LayeredDepthImage") -> str:
    """Tell counts in one line."""
    counts, canvas = image.counts(), image.canvas
    return (
        f"{counts['num_layers']} layers of {canvas.num_cameras} views: "
        f"{counts['num_values_inside']} values in the frame of {canvas.reference} "
        f"({counts['increase_percent']:+.1f} %), "
        f"{counts['num_values_beyond']} beyond it"
    )
