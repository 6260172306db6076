"""`dvc-dibr view`: a decoded scene as a page in which the viewpoint is moved by hand."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from dvc import cli
from dvc.dibr.commands.dibr_options import parse_view
from dvc.dibr.commands.dibr_reports import (
    AnyDecoded,
    decode_views,
    json_files,
    print_figures,
    read_stream,
    read_truth,
    render_view,
    shape_of,
    view_quality,
    viewpoint_of,
    warn,
)
from dvc.dibr.depth_image.piece_stream import DecodedPieces
from dvc.dibr.depth_image.scene_pieces import read_pieces
from dvc.dibr.view_stream import Decoded
from dvc.dibr.viewer_page import Caption, Scene, scene_of_pieces, scene_of_stream, write_page
from dvc.errors import ConfigError
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.viewpoints import Viewpoint

Truth = tuple[LatticePosition | int | None, str]
MAX_PIXELS = 1 << 23
"""Most pixels of all pictures of a page: browsers need some 50 bytes for each."""


def run(arguments: argparse.Namespace) -> int:
    """Write the page."""
    if Path(arguments.out).suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"the name of a page must end in .html, got {arguments.out}")
    truths = [_parse_truth(text) for text in arguments.truth]
    inputs = [arguments.path, *(path for _, path in truths)]
    cli.check_outputs(inputs, [arguments.out, *json_files(arguments)])
    if Path(arguments.path).is_dir():
        if truths or arguments.quality_layers is not None:
            raise ConfigError("--truth and --quality-layers require a stream, not a folder")
        scene, caption = _scene_of_folder(Path(arguments.path))
    else:
        scene, caption = _scene_of_stream(arguments, truths)
    write_page(arguments.out, scene, caption)
    height, width = scene.shape
    figures = {
        "page_bytes": Path(arguments.out).stat().st_size,
        "width": width,
        "height": height,
        "scene_bytes": caption.num_bytes,
        "bpp": caption.bits_per_pixel,
        "sources": len(scene.sources),
        "pieces": sum(len(source.pieces) for source in scene.sources),
        "bounds": scene.bounds._asdict(),
        "psnr_db": list(caption.qualities),
    }
    known = [f"{value:.2f} dB" for value in caption.qualities if value is not None]
    quality = f"; PSNR {', '.join(known)}" if known else ""
    sources = f"{len(scene.sources)} source{'' if len(scene.sources) == 1 else 's'}"
    text = f"{arguments.out}: {figures['page_bytes']} bytes, {sources}{quality}\n"
    print_figures(arguments, figures, text)
    return 0


def _parse_truth(text: str) -> Truth:
    """Return the position, if any, and the file of a picture; a file `K=NAME` needs its folder."""
    position, equals, path = text.partition("=")
    try:
        return (parse_view(position), path) if equals and path else (None, text)
    except argparse.ArgumentTypeError:
        return None, text


def _scene_of_stream(arguments: argparse.Namespace, truths: list[Truth]) -> tuple[Scene, Caption]:
    """Return the scene of a stream, and its caption with the quality of its views."""
    stream, num_bytes = read_stream(arguments.path, arguments.max_memory)
    decoded = shown = decode_views(arguments, stream)
    halvings = 0
    if not isinstance(decoded, DecodedPieces):
        num_pixels = sum(pair.disparity.size for pair in decoded.pairs)
        while num_pixels > MAX_PIXELS:
            num_pixels, halvings = num_pixels // 4, halvings + 1
        if halvings:
            shown = decode_views(arguments, stream, halvings)
    if isinstance(shown, DecodedPieces):
        scene = scene_of_pieces(shown.scene)
        _check_scene(scene, arguments.path)
    else:
        scene = scene_of_stream(shown)
    qualities = _qualities(decoded, _placed(decoded.viewpoints, truths), arguments.quiet)
    more = [viewpoint for viewpoint in qualities if viewpoint not in scene.viewpoints]
    scene = replace(scene, viewpoints=(*scene.viewpoints, *more))
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


def _check_scene(scene: Scene, path: str | Path) -> None:
    if not scene.sources[0].pieces:
        raise ConfigError(f"{path}: nothing to be seen in it")
    if scene.num_pixels > MAX_PIXELS:
        raise ConfigError(f"{path}: {scene.num_pixels} pixels in all; a page takes {MAX_PIXELS} at most")


def _placed(viewpoints: Sequence[Viewpoint], truths: list[Truth]) -> dict[Viewpoint, str]:
    """Return pictures by viewpoint; those without a position belong to the views in their order."""
    placed: dict[Viewpoint, str] = {}
    number = 0
    for position, path in truths:
        if position is None and number >= len(viewpoints):
            raise ConfigError(f"--truth {path}: the stream has {len(viewpoints)} views")
        viewpoint = viewpoint_of(viewpoints, number if position is None else position)
        if viewpoint in placed:
            raise ConfigError("--truth: two pictures of one view")
        placed[viewpoint] = path
        number += position is None
    return placed


def _qualities(
    decoded: AnyDecoded, truths: dict[Viewpoint, str], quiet: bool
) -> dict[Viewpoint, float | None]:
    """Return the PSNR of views in dB; None without any error."""
    pictures = {viewpoint: read_truth(path, shape_of(decoded)) for viewpoint, path in truths.items()}
    qualities: dict[Any, float | None] = {}
    with cli.progress_bar("views", len(pictures), quiet) as advance:
        for viewpoint, picture in pictures.items():
            qualities[viewpoint] = view_quality(render_view(decoded, viewpoint), picture)["psnr_db"]
            advance(1)
    return qualities


def _scene_of_folder(folder: Path) -> tuple[Scene, Caption]:
    """Return the scene of a folder of layers or sprites, and its caption."""
    pieces = read_pieces(folder)
    scene = scene_of_pieces(pieces)
    _check_scene(scene, folder)
    kind = f"{len(pieces.pieces)} {pieces.kind.name.lower()}"
    files = [path for prefix in ("colour", "sprite", "disparity") for path in folder.glob(f"{prefix}-*")]
    size = sum(path.stat().st_size for path in files)
    return scene, Caption(folder.resolve().name, f"{kind}, not coded", size, scene.shape[0] * scene.shape[1])
