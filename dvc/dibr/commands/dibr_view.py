"""`dvc-dibr view`: a decoded scene as a page in which the viewpoint is moved by hand."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dvc import cli
from dvc.dibr.commands.dibr_options import (
    add_figures,
    add_layers,
    add_memory,
    decode_views,
    json_files,
    parse_view,
    read_stream,
    render_view,
    tell,
    viewpoint_of,
    warn,
)
from dvc.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dvc.dibr.depth_image.depth_image_stream import DepthImageStream
    from dvc.dibr.depth_image.piece_decoder import DecodedPieces
    from dvc.dibr.depth_image.piece_stream import LayeredStream
    from dvc.dibr.view_rendering import DecodedViews
    from dvc.dibr.view_stream import Stream
    from dvc.dibr.viewer_page import Caption
    from dvc.dibr.viewer_scene import Scene
    from dvc.geometry.camera_array import LatticePosition
    from dvc.geometry.viewpoints import Viewpoint

SUMMARY = "a page to look around in a scene"
DESCRIPTION = (
    "Write one HTML page in which the viewpoint is moved by mouse, touch or keys; it needs WebGL 2 and no "
    "network. The scene is a stream, or a folder that dvc-stereo layers or dvc-stereo sprites has written."
)
EXAMPLES = """\
  dvc-dibr view pair.dibr --out pair.html
  dvc-dibr view pair.dibr --out pair.html --truth left.png right.png
  dvc-dibr view array.dibr --out array.html --truth 3=centre.png 0.5,0=between.png
  dvc-dibr view layers --out layers.html
"""
MAX_PIXELS = 1 << 23
"""Of all pictures of a page together: browsers need some 50 bytes for each."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("path", metavar="SCENE", help="stream, whole or cut, or folder of layers or sprites")
    parser.add_argument("--out", metavar="PAGE.html", required=True, help="the page")
    add_memory(parser)
    add_layers(parser)
    truth = (
        "pictures taken at the views of the stream, in their order, or with their positions before them, "
        "where the page shows PSNR"
    )
    parser.add_argument("--truth", nargs="+", default=[], metavar="[M,N=|K=]VIEW", help=truth)
    add_figures(parser, "show no progress and print no summary")


def run(arguments: argparse.Namespace) -> int:
    """Write the page."""
    from dvc.dibr.viewer_page import write_page

    if Path(arguments.out).suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"the name of a page must end in .html, got {arguments.out}")
    truths = [_truth(text) for text in arguments.truth]
    cli.check_outputs(
        [arguments.path, *(path for _, path in truths)], [arguments.out, *json_files(arguments)]
    )
    if Path(arguments.path).is_dir():
        if truths or arguments.quality_layers is not None:
            raise ConfigError("--truth and --quality-layers are for streams, not for folders")
        scene, caption = _folder(Path(arguments.path))
    else:
        scene, caption = _stream(arguments, truths)
    write_page(arguments.out, scene, caption)
    figures = _figures(arguments.out, scene, caption)
    known = [f"{value:.2f} dB" for value in caption.qualities if value is not None]
    quality = f"; PSNR {', '.join(known)}" if known else ""
    count = figures["sources"]
    sources = f"{count} source{'' if count == 1 else 's'}"
    text = f"{arguments.out}: {figures['page_bytes']} bytes, {sources}{quality}\n"
    tell(arguments, figures, text)
    return 0


def _truth(text: str) -> "tuple[LatticePosition | int | None, str]":
    """Return the position, if any, and the file of a picture; what looks like both needs its folder."""
    position, equals, path = text.partition("=")
    try:
        return (parse_view(position), path) if equals and path else (None, text)
    except argparse.ArgumentTypeError:
        return None, text


def _stream(
    arguments: argparse.Namespace, truths: "list[tuple[LatticePosition | int | None, str]]"
) -> "tuple[Scene, Caption]":
    """Scene of a stream, and how near its views are to pictures taken there."""
    from dataclasses import replace

    from dvc.dibr.commands.dibr_render import shape_of
    from dvc.dibr.view_decoder import Decoded
    from dvc.dibr.viewer_page import Caption

    stream, num_bytes = read_stream(arguments.path, arguments.max_memory)
    decoded = decode_views(arguments, stream)
    scene, halvings = _scene_of(arguments, stream, decoded)
    known = _qualities(decoded, _placed(decoded.viewpoints, truths), arguments.quiet)
    others = [viewpoint for viewpoint, _ in known if viewpoint not in scene.viewpoints]
    scene = replace(scene, viewpoints=(*scene.viewpoints, *others))
    qualities = dict(known)
    warn(arguments.path, decoded.damage)
    notes = []
    if decoded.damage is not None:
        notes.append(f"The stream is damaged: {cli.one_line(decoded.damage)}; what precedes it is shown.")
    elif isinstance(decoded, Decoded) and decoded.num_layers < decoded.header.num_layers:
        notes.append(f"{decoded.num_layers} of {decoded.header.num_layers} quality layers are shown.")
    if halvings:
        notes.append(f"The stream is too large for a page: its sides are shown {2**halvings} times shorter.")
    height, width = shape_of(decoded)
    return scene, Caption(
        Path(arguments.path).name,
        "decoded stream",
        num_bytes,
        height * width,
        tuple(notes),
        tuple(qualities.get(viewpoint) for viewpoint in scene.viewpoints),
    )


def _scene_of(
    arguments: argparse.Namespace,
    stream: "Stream | DepthImageStream | LayeredStream",
    decoded: "DecodedViews | DecodedPieces",
) -> "tuple[Scene, int]":
    """Scene of a decoded stream, and how often its sides are halved in it."""
    from dvc.dibr.depth_image.piece_decoder import DecodedPieces
    from dvc.dibr.viewer.canvases import scene_of_pieces
    from dvc.dibr.viewer_scene import scene_of_stream

    if isinstance(decoded, DecodedPieces):
        scene = scene_of_pieces(decoded.scene)
        _check_scene(scene, arguments.path)
        return scene, 0
    halvings = _halvings(decoded)
    if halvings:
        shown = decode_views(arguments, stream, halvings)
        assert not isinstance(shown, DecodedPieces)
        decoded = shown
    return scene_of_stream(decoded), halvings


def _check_scene(scene: "Scene", path: str | Path) -> None:
    if not scene.sources[0].pieces:
        raise ConfigError(f"{path}: nothing to be seen in it")
    if scene.num_pixels > MAX_PIXELS:
        raise ConfigError(f"{path}: {scene.num_pixels} pixels in all; a page takes {MAX_PIXELS} at most")


def _halvings(decoded: "DecodedViews") -> int:
    """How often the sides of pictures are halved, so that all of them fit into a page."""
    num_pixels, count = sum(pair.disparity.size for pair in decoded.pairs), 0
    while num_pixels > MAX_PIXELS:
        num_pixels, count = num_pixels // 4, count + 1
    return count


def _placed(
    viewpoints: "Sequence[Viewpoint]", truths: "list[tuple[LatticePosition | int | None, str]]"
) -> "list[tuple[Viewpoint, str]]":
    """Viewpoints of pictures; those without a position are of the views in their order."""
    placed: list[tuple[Viewpoint, str]] = []
    number = 0
    for position, path in truths:
        if position is None and number >= len(viewpoints):
            raise ConfigError(f"--truth {path}: the stream has {len(viewpoints)} views")
        placed.append((viewpoint_of(viewpoints, number if position is None else position), path))
        number += position is None
    if len({viewpoint for viewpoint, _ in placed}) < len(placed):
        raise ConfigError("--truth: two pictures of one view")
    return placed


def _qualities(
    decoded: "DecodedViews | DecodedPieces", truths: "list[tuple[Viewpoint, str]]", quiet: bool
) -> "list[tuple[Viewpoint, float | None]]":
    """PSNR of the views of some pictures in dB; None where there is no difference."""
    from dvc.dibr.commands.dibr_render import quality, read_truth, shape_of

    pictures = [(viewpoint, read_truth(path, shape_of(decoded))) for viewpoint, path in truths]
    known = []
    with cli.progress_bar("views", len(pictures), quiet) as advance:
        for viewpoint, picture in pictures:
            known.append((viewpoint, quality(render_view(decoded, viewpoint), picture)["psnr_db"]))
            advance(1)
    return known


def _folder(folder: Path) -> "tuple[Scene, Caption]":
    """Scene of a folder of layers or sprites."""
    from dvc.dibr.depth_image.scene_pieces import read_pieces
    from dvc.dibr.viewer.canvases import scene_of_pieces
    from dvc.dibr.viewer_page import Caption

    pieces = read_pieces(folder)
    scene = scene_of_pieces(pieces)
    _check_scene(scene, folder)
    kind = f"{len(pieces.pieces)} {pieces.kind.name.lower()}"
    files = [path for kind_of in ("colour", "sprite", "disparity") for path in folder.glob(f"{kind_of}-*")]
    size = sum(path.stat().st_size for path in files)
    return scene, Caption(folder.resolve().name, f"{kind}, not coded", size, scene.shape[0] * scene.shape[1])


def _figures(path: str, scene: "Scene", caption: "Caption") -> dict[str, Any]:
    height, width = scene.shape
    return {
        "page_bytes": Path(path).stat().st_size,
        "width": width,
        "height": height,
        "scene_bytes": caption.num_bytes,
        "bpp": caption.bits_per_pixel,
        "sources": len(scene.sources),
        "pieces": sum(len(source.pieces) for source in scene.sources),
        "bounds": scene.bounds._asdict(),
        "psnr_db": list(caption.qualities),
    }
