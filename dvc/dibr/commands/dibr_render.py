"""`dvc-dibr render` and `view`: pictures and flights of any viewpoint, and pages to look around in."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc import cli
from dvc.dibr.commands.dibr_options import parse_view
from dvc.dibr.commands.dibr_reports import (
    AnyStream,
    blue_first,
    finite_psnr,
    in_decibels,
    json_files,
    naming,
    print_figures,
    read_stream,
    read_truth,
    warn,
)
from dvc.dibr.depth_image import depth_image_stream, piece_stream
from dvc.dibr.depth_image.piece_stream import DecodedPieces
from dvc.dibr.depth_image.scene_pieces import read_pieces, render_pieces
from dvc.dibr.view_rendering import Blend, DecodedViews, picture_of, render
from dvc.dibr.view_stream import Decoded, Stream, decode
from dvc.dibr.viewer_page import Caption, Scene, scene_of_pieces, scene_of_stream, write_page
from dvc.errors import ConfigError
from dvc.files import atomic_output
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.view_synthesis import SynthesisedView
from dvc.geometry.viewpoints import Viewpoint, between
from dvc.images.colour import luma
from dvc.metrics import SSIM_WINDOW_PX, ssim
from dvc.picture_files import write_png
from dvc.video import check_suffix, create_video
from dvc.video.pixels import frame_from_rgb

AnyDecoded = DecodedViews | DecodedPieces
Truth = tuple[LatticePosition | int | None, str]
MAX_PIXELS = 1 << 23
"""Most pixels of all pictures of a page: browsers need some 50 bytes for each."""


def run_render(arguments: argparse.Namespace) -> int:
    """Render a view, or views along a path."""
    inputs = [arguments.path, *([] if arguments.truth is None else [arguments.truth])]
    cli.check_outputs(inputs, [arguments.out, *json_files(arguments)])
    if arguments.route is None:
        if Path(arguments.out).suffix.lower() != ".png":
            raise ConfigError(f"the name of a picture must end in .png, got {arguments.out}")
    elif arguments.truth is not None:
        raise ConfigError("--truth requires --view")
    elif len(arguments.route) < 2:
        raise ConfigError("--path needs at least two views")
    else:
        check_suffix(arguments.out)
    stream, _ = read_stream(arguments.path, arguments.max_memory)
    decoded = decode_views(arguments, stream)
    height, width = shape_of(decoded)
    figures: dict[str, Any] = {"width": width, "height": height}
    if arguments.route is None:
        truth = None if arguments.truth is None else read_truth(arguments.truth, (height, width))
        view = render_view(decoded, viewpoint_of(decoded.viewpoints, arguments.view), arguments.blend)
        with atomic_output(arguments.out) as temporary:
            write_png(temporary, blue_first(picture_of(view)))
        figures["filled_share"] = float(1.0 - view.drawn.mean())
        figures |= {} if truth is None else view_quality(view, truth)
        parts = [f"{width}x{height}, {100 * figures['filled_share']:.1f} % filled"]
        names = {"psnr_db": "PSNR", "psnr_visible_db": "visible", "psnr_filled_db": "filled"}
        parts += in_decibels(figures, names)
        parts += [f"SSIM {figures['ssim']:.4f}"] if figures.get("ssim") is not None else []
        text = "; ".join(parts)
    else:
        stops = [viewpoint_of(decoded.viewpoints, view) for view in arguments.route]
        with (
            create_video(arguments.out, (width, height), arguments.frame_rate) as video,
            cli.progress_bar("frames", arguments.frames, arguments.quiet) as advance,
        ):
            for number in range(arguments.frames):
                way = number * (len(stops) - 1) / (arguments.frames - 1)
                leg = min(int(way), len(stops) - 2)
                viewpoint = between(stops[leg], stops[leg + 1], way - leg)
                video.write(frame_from_rgb(picture_of(render_view(decoded, viewpoint, arguments.blend))))
                advance(1)
        figures["frames"] = arguments.frames
        text = f"{arguments.frames} frames of {width}x{height}"
    warn(arguments.path, decoded.damage)
    print_figures(arguments, figures | {"damage": decoded.damage}, f"{arguments.out}: {text}\n")
    return 0


def decode_views(arguments: argparse.Namespace, stream: AnyStream, resolution: int = 0) -> AnyDecoded:
    """Decode a stream of any kind, to be rendered."""
    path, num_layers = arguments.path, arguments.quality_layers
    with naming(path):
        if isinstance(stream, Stream):
            return decode(stream, num_layers, resolution)
        if num_layers is not None:
            raise ConfigError(f"--quality-layers: {path} has none, but can be cut anywhere")
        if isinstance(stream, piece_stream.LayeredStream):
            return piece_stream.decode(stream)
        if stream.picture is None:
            raise ConfigError(f"{path}: a depth map only, without a picture to render")
        return depth_image_stream.decode(stream, resolution)


def viewpoint_of(viewpoints: Sequence[Viewpoint], view: LatticePosition | int) -> Viewpoint:
    """Return a parsed viewpoint."""
    if not isinstance(view, LatticePosition):
        if view >= len(viewpoints):
            raise ConfigError(f"view {view}: the stream has 0 to {len(viewpoints) - 1}")
        return viewpoints[view]
    if not isinstance(viewpoints[0], LatticePosition):
        raise ConfigError(
            f"view {view.m:g},{view.n:g}: the cameras of the stream are on no lattice; "
            f"numbers from 0 to {len(viewpoints) - 1} are accepted"
        )
    return view


def shape_of(decoded: AnyDecoded) -> tuple[int, int]:
    """Return the size of the pictures of a decoded stream."""
    if isinstance(decoded, DecodedPieces):
        return decoded.shape
    height, width = decoded.pairs[0].disparity.shape
    return height, width


def render_view(decoded: AnyDecoded, viewpoint: Viewpoint, blend: str = "distance") -> SynthesisedView:
    """Render a view of a decoded stream of any kind."""
    if isinstance(decoded, DecodedPieces):
        assert isinstance(viewpoint, LatticePosition), "layers and sprites are rectified"
        return render_pieces(decoded.scene, viewpoint)
    return render(decoded, viewpoint, Blend(blend))


def view_quality(view: SynthesisedView, truth: NDArray[np.uint8]) -> dict[str, float | None]:
    """Return the quality of a rendered view, compared with a picture of that viewpoint."""
    rendered, target = luma(picture_of(view)), luma(truth)
    return {
        "psnr_db": finite_psnr(rendered.reshape(1, -1), target.reshape(1, -1)),
        "ssim": ssim(rendered, target) if min(rendered.shape) >= SSIM_WINDOW_PX else None,
        "psnr_visible_db": finite_psnr(rendered[None, view.drawn], target[None, view.drawn]),
        "psnr_filled_db": finite_psnr(rendered[None, ~view.drawn], target[None, ~view.drawn]),
    }


def run_view(arguments: argparse.Namespace) -> int:
    """Write the page."""
    if Path(arguments.out).suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"the name of a page must end in .html, got {arguments.out}")
    truths = [_parse_truth(text) for text in arguments.truth]
    inputs = [arguments.path, *(path for _, path in truths)]
    cli.check_outputs(inputs, [arguments.out, *json_files(arguments)])
    if Path(arguments.path).is_dir():
        if truths or arguments.quality_layers is not None:
            raise ConfigError("--truth and --quality-layers require a stream, not a folder")
        folder = Path(arguments.path)
        pieces = read_pieces(folder)
        scene = scene_of_pieces(pieces)
        _check_scene(scene, folder)
        kind = f"{len(pieces.pieces)} {pieces.kind.name.lower()}, not coded"
        files = [path for prefix in ("colour", "sprite", "disparity") for path in folder.glob(f"{prefix}-*")]
        size = sum(path.stat().st_size for path in files)
        caption = Caption(folder.resolve().name, kind, size, scene.shape[0] * scene.shape[1])
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
    pictures = _pictures(decoded, truths)
    qualities: dict[Viewpoint, float | None] = {}
    with cli.progress_bar("views", len(pictures), arguments.quiet) as advance:
        for viewpoint, picture in pictures.items():
            qualities[viewpoint] = view_quality(render_view(decoded, viewpoint), picture)["psnr_db"]
            advance(1)
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
    name, known = Path(arguments.path).name, tuple(map(qualities.get, scene.viewpoints))
    return scene, Caption(name, "decoded stream", num_bytes, height * width, tuple(notes), known)


def _check_scene(scene: Scene, path: str | Path) -> None:
    if not scene.sources[0].pieces:
        raise ConfigError(f"{path}: nothing to be seen in it")
    num_pixels = sum(piece.mask.size for source in scene.sources for piece in source.pieces)
    if num_pixels > MAX_PIXELS:
        raise ConfigError(f"{path}: {num_pixels} pixels in all; a page takes {MAX_PIXELS} at most")


def _pictures(decoded: AnyDecoded, truths: list[Truth]) -> dict[Viewpoint, NDArray[np.uint8]]:
    """Return pictures by viewpoint; those without a position belong to the views in their order."""
    paths: dict[Viewpoint, str] = {}
    number = 0
    for position, path in truths:
        if position is None and number >= len(decoded.viewpoints):
            raise ConfigError(f"--truth {path}: the stream has {len(decoded.viewpoints)} views")
        viewpoint = viewpoint_of(decoded.viewpoints, number if position is None else position)
        if viewpoint in paths:
            raise ConfigError("--truth: two pictures of one view")
        paths[viewpoint] = path
        number += position is None
    return {viewpoint: read_truth(path, shape_of(decoded)) for viewpoint, path in paths.items()}
