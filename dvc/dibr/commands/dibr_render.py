"""`dvc-dibr render`: any view of a stream, or a flight through it."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dvc import cli
from dvc.dibr.commands.dibr_reports import (
    AnyDecoded,
    blue_first,
    decode_views,
    in_decibels,
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
from dvc.dibr.view_rendering import picture_of
from dvc.errors import ConfigError
from dvc.files import atomic_output
from dvc.geometry.viewpoints import Viewpoint, between
from dvc.picture_files import write_png
from dvc.video import check_suffix, create_video
from dvc.video.pixels import frame_from_rgb


def run(arguments: argparse.Namespace) -> int:
    """Render."""
    _check(arguments)
    stream, _ = read_stream(arguments.path, arguments.max_memory)
    decoded = decode_views(arguments, stream)
    height, width = shape_of(decoded)
    figures: dict[str, Any] = {"width": width, "height": height}
    if arguments.route is None:
        figures |= _render_picture(arguments, decoded)
        parts = [f"{width}x{height}, {100 * figures['filled_share']:.1f} % filled"]
        names = {"psnr_db": "PSNR", "psnr_visible_db": "visible", "psnr_filled_db": "filled"}
        parts += in_decibels(figures, names)
        parts += [f"SSIM {figures['ssim']:.4f}"] if figures.get("ssim") is not None else []
        text = "; ".join(parts)
    else:
        _render_video(arguments, decoded)
        figures["frames"] = arguments.frames
        text = f"{arguments.frames} frames of {width}x{height}"
    warn(arguments.path, decoded.damage)
    print_figures(arguments, figures | {"damage": decoded.damage}, f"{arguments.out}: {text}\n")
    return 0


def _check(arguments: argparse.Namespace) -> None:
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


def _render_picture(arguments: argparse.Namespace, decoded: AnyDecoded) -> dict[str, Any]:
    """Render one view into a file and return its figures."""
    truth = None if arguments.truth is None else read_truth(arguments.truth, shape_of(decoded))
    view = render_view(decoded, viewpoint_of(decoded.viewpoints, arguments.view), arguments.blend)
    with atomic_output(arguments.out) as temporary:
        write_png(temporary, blue_first(picture_of(view)))
    figures: dict[str, Any] = {"filled_share": float(1.0 - view.drawn.mean())}
    return figures if truth is None else figures | view_quality(view, truth)


def _render_video(arguments: argparse.Namespace, decoded: AnyDecoded) -> None:
    """Render views along a path into a video."""
    stops = [viewpoint_of(decoded.viewpoints, view) for view in arguments.route]
    height, width = shape_of(decoded)
    with (
        create_video(arguments.out, (width, height), arguments.frame_rate) as video,
        cli.progress_bar("frames", arguments.frames, arguments.quiet) as advance,
    ):
        for viewpoint in along(stops, arguments.frames):
            picture = picture_of(render_view(decoded, viewpoint, arguments.blend))
            video.write(frame_from_rgb(picture))
            advance(1)


def along(stops: Sequence[Viewpoint], num_frames: int) -> list[Viewpoint]:
    """Return viewpoints along a path."""
    viewpoints = []
    for number in range(num_frames):
        way = number * (len(stops) - 1) / (num_frames - 1)
        leg = min(int(way), len(stops) - 2)
        viewpoints.append(between(stops[leg], stops[leg + 1], way - leg))
    return viewpoints
