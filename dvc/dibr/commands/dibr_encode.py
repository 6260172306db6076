"""`dvc-dibr encode`: views, a picture with depth, a depth map, or layers to a stream."""

import argparse
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from dvc import array_files, cli
from dvc.dibr import view_set
from dvc.dibr.commands.dibr_options import AUTOMATIC, EDGES, KEEP, TRANSFORMS, WAVELETS
from dvc.dibr.commands.dibr_reports import (
    PSNR_NAMES,
    SUFFIX,
    check_size,
    depth_image_quality,
    in_decibels,
    json_files,
    print_figures,
    read_with_holes,
)
from dvc.dibr.depth_image import (
    depth_image_encoder,
    depth_image_stream,
    piece_encoder,
    piece_selection,
    piece_stream,
)
from dvc.dibr.depth_image.depth_image_encoder import CodedEdges, DepthOptions, code_edges
from dvc.dibr.depth_image.depth_image_stream import MAX_BYTES
from dvc.dibr.depth_image.scene_pieces import luma_from, read_pieces
from dvc.dibr.dibr_streams import DEFAULT_CODEC
from dvc.dibr.view_encoder import ViewEncoder
from dvc.dibr.view_set import Views
from dvc.errors import ConfigError
from dvc.files import atomic_output
from dvc.geometry.camera_array import DisparityLabels
from dvc.geometry.camera_files import load_cameras
from dvc.images.colour import luma
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edge_selection import canny_edges, read_edges
from dvc.images.lifting import most_levels
from dvc.picture_files import read_picture


class Kind(StrEnum):
    """Kinds of input, with their names in messages."""

    VIEWS = "two or more views"
    IMAGE = "a picture with --depth"
    MAP = "a depth map"
    LAYERS = "a folder of layers or sprites"


_VIEWS, _MAPS, _PICTURES = (Kind.VIEWS,), (Kind.IMAGE, Kind.MAP), (Kind.IMAGE, Kind.LAYERS)
OPTIONS: dict[str, tuple[tuple[Kind, ...], Any]] = {
    **dict.fromkeys(("lattice", "views", "disparities", "cameras", "depths", "multiplier"), (_VIEWS, None)),
    "disparity": (_VIEWS, DEFAULT_CODEC),
    "quality_layers": (_VIEWS, 1),
    "references": (_VIEWS, ()),
    "gray": ((Kind.VIEWS, *_PICTURES), False),
    "depth": ((Kind.IMAGE,), None),
    **dict.fromkeys(("near_far", "hole", "no_holes"), (_MAPS, None)),
    "depth_scale": (_MAPS, 1.0),
    "transform": (_MAPS, TRANSFORMS[0]),
    "edges": (_MAPS, EDGES[0]),
    "wavelet": ((*_MAPS, Kind.LAYERS), WAVELETS[0]),
    "order_depth": ((*_MAPS, Kind.LAYERS), 1),
    "order_image": (_PICTURES, 0),
    "depth_share": (_PICTURES, 0.2),
    "keep": ((Kind.LAYERS,), KEEP[0]),
}
"""Kinds of input that accept an option, and its default."""


def run(arguments: argparse.Namespace) -> int:
    """Encode."""
    *paths, out = arguments.paths
    if not paths or Path(out).suffix.lower() != SUFFIX:
        raise ConfigError(f"the last name must be that of the stream and end in {SUFFIX}, got {out}")
    if len(paths) > 1:
        kind = Kind.VIEWS
    elif Path(paths[0]).is_dir():
        kind = Kind.LAYERS
    else:
        kind = Kind.MAP if arguments.depth is None else Kind.IMAGE
    for name, (kinds, default) in OPTIONS.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, default)
        elif kind not in kinds:
            option = "--lambda" if name == "multiplier" else f"--{name.replace('_', '-')}"
            raise ConfigError(f"{option} requires {' or '.join(kinds)}; the input is {kind}")
    if (arguments.bpp is None) == (arguments.multiplier is None):
        raise ConfigError("expected --bpp, or --lambda for views")
    inputs = [*paths, *array_files.table_files(arguments)]
    inputs += [path for path in (arguments.depth, arguments.edges) if path not in (None, *EDGES)]
    cli.check_outputs(cli.with_contents(inputs), [out, *json_files(arguments)])
    encode = {Kind.VIEWS: _encode_views, Kind.LAYERS: _encode_layers}.get(kind, _encode_depth_image)
    data, figures, text = encode(arguments, paths)

    with atomic_output(out) as temporary:
        temporary.write_bytes(data)
    print_figures(arguments, figures, f"{out}: {text}\n")
    return 0


@contextmanager
def _max_bytes(arguments: argparse.Namespace, num_pixels: int) -> Iterator[int]:
    """Return the largest file of the rate, up to `MAX_BYTES`, and prefix errors with the rate."""
    try:
        yield int(min(arguments.bpp * num_pixels / 8.0, MAX_BYTES))
    except ConfigError as err:
        raise ConfigError(f"--bpp {arguments.bpp:g} of {num_pixels} pixels: {err}") from None


Result = tuple[bytes, dict[str, Any], str]
"""A stream, its figures, and a summary."""


def _encode_views(arguments: argparse.Namespace, paths: list[str]) -> Result:
    views, labels = _read_views(arguments, paths)
    num_layers, num_pixels = arguments.quality_layers, views.shape[0] * views.shape[1]
    by_rate = arguments.multiplier is None
    total = None if by_rate else num_layers * len(views.references)
    with cli.progress_bar("rate: layers" if by_rate else "layers", total, arguments.quiet) as advance:
        encoder = ViewEncoder(views, labels, arguments.disparity, num_layers, advance)
        if by_rate:
            with _max_bytes(arguments, num_pixels) as max_bytes:
                encoded = encoder.encode_to_size(max_bytes)
        else:
            encoded = encoder.encode(arguments.multiplier)
    header = encoder.header
    figures = {
        "stream_bytes": len(encoded.data),
        "bpp": 8 * len(encoded.data) / num_pixels,
        "lambda": encoded.multiplier,
        "bits": {
            "header": 8 * encoded.header_bytes,
            "picture": 8 * encoded.picture_bytes,
            "disparity": 8 * encoded.disparity_bytes,
        },
        "disparity_share": encoded.disparity_share,
        "disparity": header.method,
        "quality_layers": header.num_layers,
        "labels": header.labels._asdict(),
        "references": list(header.references),
        "width": views.shape[1],
        "height": views.shape[0],
        "colour": views.pictures[0].ndim == 3,
    }
    share = f"{100 * encoded.disparity_share:.1f} % of it disparities; lambda {encoded.multiplier:.3g}"
    return encoded.data, figures, f"{figures['bpp']:.4f} bits per pixel, {share}"


def _read_views(arguments: argparse.Namespace, paths: list[str]) -> tuple[Views, DisparityLabels]:
    """Read views, and return them with their labels."""
    references = [0]
    for name in arguments.references:
        matches = [number for number, path in enumerate(paths) if name in (path, Path(path).name)]
        if not matches:
            raise ConfigError(f"reference {name} is not among the views")
        references += [number for number in matches[:1] if number not in references]
    if arguments.cameras is None:
        if arguments.depths is not None:
            raise ConfigError("--depths requires --cameras; rectified views have --disparities")
        if arguments.disparities is None:
            raise ConfigError("--disparities MIN:MAX is required, in pixels per unit of m")
        array = array_files.load_array(paths, array_files.positions_of(arguments, paths))
        return view_set.views_of_array(array, references, gray=arguments.gray), arguments.disparities
    for name in ("disparities", "lattice", "views"):
        if getattr(arguments, name) is not None:
            raise ConfigError(f"--{name} requires rectified views; --cameras takes --depths")
    pictures = array_files.read_pictures_of_one_size(paths)
    calibrated = view_set.with_near_origin(load_cameras(arguments.cameras, paths, pictures))
    views = view_set.views_of_cameras(pictures, calibrated.cameras, references, gray=arguments.gray)
    depths = arguments.depths or (*view_set.depths_of_points(views, calibrated.points), None)
    return views, view_set.labels_of_depths(views, *depths)


def _encode_depth_image(arguments: argparse.Namespace, paths: list[str]) -> Result:
    picture = coded = None
    path, near_far = arguments.depth or paths[0], arguments.near_far
    if arguments.depth is not None:
        picture = read_picture(paths[0])
    depth_map = read_with_holes(path, arguments, near_far is None)
    try:
        scale = depth_map.scale(arguments.depth_scale, near_far)
    except ConfigError as err:
        raise ConfigError(f"{path}: {err}") from None
    shape = depth_map.depth.shape[0], depth_map.depth.shape[1]
    if picture is not None:
        check_size(path, shape, picture.shape[:2], paths[0])
        if near_far is None:
            reach_px, width = abs(scale.disparity(depth_map.depth)).max(), picture.shape[1]
            if reach_px > width:
                sys.stderr.write(
                    f"dvc-dibr: {path}: disparities of up to {reach_px:.0f} pixels, the picture is {width} "
                    "wide; --depth-scale is the disparity of 1 in the map\n"
                )
        is_gray = arguments.gray or bool((picture == picture[:, :, :1]).all())
        coded = luma(picture) if is_gray else picture
    depth_image_stream.check_map(shape, scale)
    share = None if arguments.depth_share == AUTOMATIC else arguments.depth_share
    levels = min(DepthOptions.num_levels, most_levels(shape))
    num_pixels = shape[0] * shape[1]
    edges: CodedEdges | None = code_edges(EdgeMaps.none(shape))
    if arguments.transform != TRANSFORMS[1]:
        makers = {"canny": lambda: canny_edges(depth_map.depth), "none": lambda: EdgeMaps.none(shape)}
        make = makers.get(arguments.edges, lambda: read_edges(arguments.edges, shape))
        edges = None if arguments.edges == "auto" else code_edges(make())
    elif arguments.edges != EDGES[0]:
        raise ConfigError("--edges requires the shape-adaptive transform")
    orders = arguments.order_depth, arguments.order_image
    options = DepthOptions(arguments.wavelet, levels, *orders, share)
    is_quiet = arguments.quiet or edges is not None
    bar = cli.progress_bar("selections of edges", depth_image_encoder.NUM_STEPS, is_quiet)
    with bar as advance, _max_bytes(arguments, num_pixels) as max_bytes:
        image = depth_image_encoder.DepthImage(depth_map.depth, scale, coded)
        encoded = depth_image_encoder.encode_to_size(image, max_bytes, edges, options, advance)
    bits = {name: 8 * size for name, size in encoded.part_bytes.items()}
    decoded = depth_image_stream.decode(encoded.stream)
    figures = {
        "stream_bytes": len(encoded.data),
        "bpp": 8 * len(encoded.data) / num_pixels,
        "bits": bits,
        "edge_elements": encoded.edges.count() if encoded.edges is not None else 0,
        "depth_share": (bits["edges"] + bits["depth"]) / max(sum(bits.values()) - bits["header"], 1),
        "image_edges": encoded.stream.picture_edges,
        "width": shape[1],
        "height": shape[0],
        **depth_image_quality(decoded, depth_map, picture),
    }
    share_of_edges = f"{bits['edges']} of them {figures['edge_elements']} edges"
    text = f"{figures['bpp']:.4f} bits per pixel, {8 * len(encoded.data)} bits, {share_of_edges}"
    return encoded.data, figures, "; ".join([text, *in_decibels(figures, PSNR_NAMES)])


def _encode_layers(arguments: argparse.Namespace, paths: list[str]) -> Result:
    if arguments.depth_share == AUTOMATIC:
        raise ConfigError("--depth-share auto requires a picture with --depth")
    scene = read_pieces(paths[0])
    frame = scene.canvas.frame
    num_pixels, keeps_all = frame.width * frame.height, arguments.keep == KEEP[1]
    orders = arguments.order_depth, arguments.order_image
    options = DepthOptions(arguments.wavelet, DepthOptions.num_levels, *orders, arguments.depth_share)
    gray = arguments.gray
    total = len(scene.pieces) if keeps_all else piece_selection.MOST_TRIALS
    bar = cli.progress_bar("pieces" if keeps_all else "trials", total, arguments.quiet)
    with bar as advance, _max_bytes(arguments, num_pixels) as max_bytes:
        if keeps_all:
            coded = scene
            encoded = piece_encoder.encode_to_size(scene, max_bytes, options, advance, gray=gray)
        else:
            selected = piece_selection.encode_best(scene, max_bytes, options, advance, gray)
            encoded, coded = selected.encoded, selected.scene
    decoded = piece_stream.decode(piece_stream.decode_stream(encoded.data)).scene
    pairs = [pair for pair in zip(decoded.pieces, coded.pieces, strict=True) if pair[1].mask.any()]
    colour = [np.float64(one.colour[one.mask]) - other.colour[other.mask] for one, other in pairs]
    disparity = [np.float64(one.disparity[one.mask]) - other.disparity[other.mask] for one, other in pairs]
    known = [other.disparity[other.mask] for _, other in pairs]
    extent = float(np.ptp(np.concatenate(known))) if known else 0.0
    views = [luma_from(decoded, one) - luma_from(scene, one) for one in piece_selection.viewpoints_of(scene)]
    figures: dict[str, Any] = {
        "stream_bytes": len(encoded.data),
        "bpp": 8 * len(encoded.data) / num_pixels,
        "kind": scene.kind.name.lower(),
        "num_pieces": len(coded.pieces),
        "num_given": len(scene.pieces),
        "num_values": coded.num_values,
        "num_values_given": scene.num_values,
        "bits": {name: 8 * size for name, size in encoded.part_bytes.items()},
        "edge_elements": encoded.edge_elements,
        "psnr_image_db": _psnr(colour, 255.0),
        "psnr_disparity_db": _psnr(disparity, extent),
        "psnr_views_db": _psnr(views, 255.0),
    }
    names = {"psnr_disparity_db": "disparity", "psnr_image_db": "colour", "psnr_views_db": "views"}
    bits = f"{8 * encoded.part_bytes['edges']} of {8 * len(encoded.data)} bits for masks and edges"
    text = (
        f"{len(coded.pieces)} {figures['kind']} of {len(scene.pieces)}, {figures['bpp']:.4f} bits per pixel"
    )
    return encoded.data, figures, "; ".join([f"{text}, {bits}", *in_decibels(figures, names)])


def _psnr(errors: list[Any], peak: float) -> float | None:
    error = float(np.mean(np.concatenate(errors) ** 2)) if errors else 0.0
    return 10.0 * math.log10(peak**2 / error) if error and peak else None
