"""`dvc-dibr encode`: views to a stream."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc import array_files, cli
from dvc.dibr.commands.dibr_options import (
    add_figures,
    bytes_of,
    json_files,
    naming_rate,
    parse_multiplier,
    tell,
    write_stream,
)
from dvc.dibr.limits import MAX_LAYERS
from dvc.dibr.names import DEFAULT, NUMBERS
from dvc.errors import ConfigError

if TYPE_CHECKING:
    from dvc.dibr.view_encoder import Encoded, ViewEncoder
    from dvc.dibr.view_set import Views
    from dvc.geometry.camera_array import DisparityLabels

SUMMARY = "views to a stream"
DESCRIPTION = """\
Code a reference view with the disparities that predict the other views best for their bits. The first picture
is the reference, the last name is that of the stream. docs/dibr.md describes the stream.
"""
EXAMPLES = """\
  dvc-dibr encode left.png right.png pair.dibr --disparities 0:60 --bpp 0.5
  dvc-dibr encode c.png l.png r.png out.dibr --lattice 0,0 -1,0 1,0 --disparities 0:16:0.5 --lambda 2e-3
  dvc-dibr encode *.png out.dibr --views views.csv --disparities -4:12 --bpp 0.3 --quality-layers 7
  dvc-dibr encode a.png b.png c.png out.dibr --cameras cameras.json --depths 2:50 --bpp 0.5 --references c.png
"""
SUFFIX = ".dibr"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    files = "pictures, the reference first, then the stream to write: REFERENCE VIEW... OUT.dibr"
    parser.add_argument("paths", nargs="+", metavar="FILE", help=files)
    array_files.add_array_options(parser)
    array_files.add_camera_option(parser, refined=False)
    depths = (
        "nearest and farthest depth with --cameras; FAR may be inf; LABELS: how many, even in inverse depth, "
        "by default at most a pixel apart; default: those of known points"
    )
    parser.add_argument("--depths", type=parse_depths, metavar="NEAR:FAR[:LABELS]", help=depths)
    rate = parser.add_mutually_exclusive_group(required=True)
    bpp = "bits of the whole file per pixel of the reference, at most"
    rate.add_argument("--bpp", type=cli.parse_positive, metavar="R", help=bpp)
    multiplier = "Lagrange multiplier: squared error (intensities from 0 to 1) that a bit per pixel is worth"
    rate.add_argument("--lambda", dest="multiplier", type=parse_multiplier, metavar="L", help=multiplier)
    method = "how disparities are coded; default: %(default)s"
    parser.add_argument("--disparity", choices=NUMBERS, default=DEFAULT, help=method)
    cli.add_integer(parser, "--quality-layers", (1, MAX_LAYERS), "layers that can be cut off", default=1)
    references = "views that are coded as well, with disparities of their own"
    parser.add_argument("--references", nargs="+", default=(), metavar="VIEW", help=references)
    parser.add_argument("--gray", action="store_true", help="code luma alone")
    add_figures(parser, "show no progress and print no summary")


def parse_depths(text: str) -> tuple[float, float, int | None]:
    """Read a range of depths."""
    near, *others = text.split(":")
    if len(others) not in (1, 2):
        raise argparse.ArgumentTypeError(f"expected NEAR:FAR or NEAR:FAR:LABELS such as 2:50, got {text!r}")
    closest = cli.parse_positive(near)
    farthest = float("inf") if others[0] == "inf" else cli.parse_positive(others[0])
    if closest >= farthest:
        raise argparse.ArgumentTypeError(f"expected NEAR < FAR, got {text!r}")
    labels = cli.integer(2, array_files.MAX_LABELS)(others[1]) if len(others) == 2 else None
    return closest, farthest, labels


def run(arguments: argparse.Namespace) -> int:
    """Encode."""
    *paths, out = arguments.paths
    if Path(out).suffix.lower() != SUFFIX:
        raise ConfigError(f"the last name must be that of the stream and end in {SUFFIX}, got {out}")
    inputs = cli.with_contents([*paths, *array_files.table_files(arguments)])
    cli.check_outputs(inputs, [out, *json_files(arguments)])
    views, labels = _views(arguments, paths)
    encoder, encoded = _encoded(arguments, views, labels)
    write_stream(out, encoded.data)
    figures = _figures(encoder, encoded)
    share = f"{100 * encoded.disparity_share:.1f} % of it disparities; lambda {encoded.multiplier:.3g}"
    tell(arguments, figures, f"{out}: {figures['bpp']:.4f} bits per pixel, {share}\n")
    return 0


def _views(arguments: argparse.Namespace, paths: list[str]) -> tuple["Views", "DisparityLabels"]:
    """Read the views, and which disparities there are."""
    from dvc.dibr.view_set import views_of_array

    references = _references(paths, arguments.references)
    if arguments.cameras is not None:
        return _calibrated(arguments, paths, references)
    if arguments.depths is not None:
        raise ConfigError("--depths needs --cameras; rectified views have --disparities")
    if arguments.disparities is None:
        raise ConfigError("--disparities MIN:MAX is needed, in pixels per unit of m")
    array = array_files.load_array(paths, array_files.positions_of(arguments, paths))
    return views_of_array(array, references, gray=arguments.gray), arguments.disparities


def _references(paths: list[str], names: list[str]) -> tuple[int, ...]:
    """Numbers of the views that are coded."""
    references = [0]
    for name in names:
        found = [number for number, path in enumerate(paths) if name in (path, Path(path).name)]
        if not found:
            raise ConfigError(f"reference {name} is not among the views")
        references += [number for number in found[:1] if number not in references]
    return tuple(references)


def _calibrated(
    arguments: argparse.Namespace, paths: list[str], references: tuple[int, ...]
) -> tuple["Views", "DisparityLabels"]:
    """Read views of general cameras."""
    from dvc.dibr.views.calibrated import (
        depths_of_points,
        labels_of_depths,
        views_of_cameras,
        with_near_origin,
    )
    from dvc.geometry.camera_files import load_cameras

    given = {
        "--disparities": arguments.disparities,
        "--lattice": arguments.lattice,
        "--views": arguments.views,
    }
    named = next((name for name, value in given.items() if value is not None), None)
    if named is not None:
        raise ConfigError(f"{named} is for rectified views; with --cameras there are --depths")
    pictures = array_files.read_pictures_of_one_size(paths)
    calibrated = with_near_origin(load_cameras(arguments.cameras, paths, pictures))
    views = views_of_cameras(pictures, calibrated.cameras, references, gray=arguments.gray)
    near, far, num_labels = arguments.depths or (*depths_of_points(views, calibrated.points), None)
    return views, labels_of_depths(views, near, far, num_labels)


def _encoded(
    arguments: argparse.Namespace, views: "Views", labels: "DisparityLabels"
) -> tuple["ViewEncoder", "Encoded"]:
    """Encode at the lambda or rate that is wanted."""
    from dvc.dibr.view_encoder import ViewEncoder
    from dvc.dibr.views.rate_control import encode_to_size

    num_layers = arguments.quality_layers
    known = arguments.multiplier is not None
    total = num_layers * len(views.references) if known else None
    with cli.progress_bar("layers" if known else "rate: layers", total, arguments.quiet) as advance:
        encoder = ViewEncoder(views, labels, arguments.disparity, num_layers, advance)
        if known:
            return encoder, encoder.encode(arguments.multiplier)
        num_pixels = views.shape[0] * views.shape[1]
        with naming_rate(arguments.bpp, num_pixels):
            return encoder, encode_to_size(encoder, bytes_of(arguments.bpp, num_pixels))


def _figures(encoder: "ViewEncoder", encoded: "Encoded") -> dict[str, Any]:
    header = encoder.header
    height, width = header.shape
    parts = {
        "header": encoded.header_bytes,
        "picture": encoded.picture_bytes,
        "disparity": encoded.disparity_bytes,
    }
    return {
        "stream_bytes": len(encoded.data),
        "bpp": 8 * len(encoded.data) / (width * height),
        "lambda": encoded.multiplier,
        "bits": {name: 8 * size for name, size in parts.items()},
        "disparity_share": encoded.disparity_share,
        "disparity": header.method,
        "quality_layers": header.num_layers,
        "labels": header.labels._asdict(),
        "references": list(header.references),
        "width": width,
        "height": height,
        "colour": encoder.views.pictures[0].ndim == 3,
    }
