"""The look of all pictures: tracks and snakes, panels, correlation noise, PSNR by frame."""

import argparse
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures.harness import MissingClip
from dvc import cli
from dvc.files import atomic_output
from dvc.page.plotting import COLOURS, DPI
from dvc.tracks import PointTracks

ZOOM = 3
PANEL_WIDTH = 528
QUALITY = 80
_BANNER = 30
_SHIFT = 4  # fractional bits of drawn positions
_RED, _MAGENTA, _ORANGE, _GREEN = (40, 40, 235), (220, 60, 220), (30, 150, 250), (70, 200, 40)
"""Blue, green and red of each."""
Picture = NDArray[np.uint8]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Line:
    """One curve of a plot by frame."""

    label: str  # for the legend
    points: Mapping[int, float]  # PSNR in dB by frame
    colour: int  # its number in `dvc.page.plotting.COLOURS`
    style: str = "-"  # of the line, as matplotlib knows it
    # PSNR of the key frames, which the line goes through too; not drawn if empty
    peaks: Mapping[int, float] | None = None
    # distance of the key frames, at which the line is cut; None: where frames are missing
    gop: int | None = None


def draw_tracks(luma: NDArray[np.uint8], tracks: PointTracks) -> Picture:
    """Draw the tracks of points over the key frame that they start from."""
    canvas = _enlarged(luma)
    for track in tracks.positions:
        known = track[np.isfinite(track).all(axis=1)]
        _draw_path(canvas, known, _MAGENTA, 2)
        _draw_dots(canvas, known[:1], _RED, 3)
        if len(known) < len(track):
            _draw_dots(canvas, known[-1:], _ORANGE, 3)
    return canvas


def draw_snakes(luma: NDArray[np.uint8], tracks: PointTracks) -> Picture:
    """Draw tracks over a key frame: where points were found, and the even motion that they do not follow."""
    canvas = _enlarged(luma)
    for track in tracks.positions:
        known = track[np.isfinite(track).all(axis=1)]
        _draw_path(canvas, track[[0, -1]], _GREEN, 1)
        _draw_path(canvas, known, _MAGENTA, 1)
        _draw_dots(canvas, known, _RED, 2)
    return canvas


def _enlarged(luma: NDArray[np.uint8]) -> Picture:
    """Return a faded copy of a frame to draw on."""
    height, width = luma.shape
    grey = cv2.resize(luma, (ZOOM * width, ZOOM * height), interpolation=cv2.INTER_CUBIC)
    faded = (96 + grey.astype(np.int64) * 150 // 255).astype(np.uint8)
    return np.repeat(faded[:, :, None], 3, axis=2)


def _fixed_point(points: Floats) -> NDArray[np.int32]:
    """Scale to the enlarged picture, whose pixel centres are between those of the frame."""
    return np.rint((ZOOM * (points + 0.5) - 0.5) * (1 << _SHIFT)).astype(np.int32)


def _draw_path(canvas: Picture, points: Floats, colour: tuple[int, int, int], width_px: int) -> None:
    at = _fixed_point(points).reshape(-1, 1, 2)
    cv2.polylines(canvas, [at], False, colour, width_px, cv2.LINE_AA, _SHIFT)


def _draw_dots(canvas: Picture, points: Floats, colour: tuple[int, int, int], radius_px: int) -> None:
    for x, y in _fixed_point(points):
        cv2.circle(canvas, (int(x), int(y)), radius_px << _SHIFT, colour, -1, cv2.LINE_AA, _SHIFT)


def panel(plane: NDArray[np.uint8], title: str) -> Picture:
    """Scale a picture to the width of a panel and put a title above it."""
    colour = plane if plane.ndim == 3 else np.repeat(plane[:, :, None], 3, axis=2)
    height = round(PANEL_WIDTH * colour.shape[0] / colour.shape[1])
    scaled = cv2.resize(colour, (PANEL_WIDTH, height), interpolation=cv2.INTER_CUBIC)
    banner = np.full((_BANNER, PANEL_WIDTH, 3), 255, dtype=np.uint8)
    cv2.putText(banner, title, (4, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.52, (30, 30, 30), 1, cv2.LINE_AA)
    framed: Picture = np.vstack([banner, np.asarray(scaled, np.uint8)])
    return framed


def in_pairs(panels: Sequence[Picture]) -> Picture:
    """Put panels of one size into rows of two."""
    gap = np.full((panels[0].shape[0], 8, 3), 255, dtype=np.uint8)
    rows = [np.hstack([panels[k], gap, panels[k + 1]]) for k in range(0, len(panels), 2)]
    picture: Picture = np.vstack(rows)
    return picture


def correlation_noise(predicted: Floats, original: NDArray[np.uint8]) -> Picture:
    """Show the difference of side information and frame, grey where there is none."""
    return np.clip(128.0 + 2.0 * (predicted - original), 0, 255).astype(np.uint8)


def write_picture(path: Path, picture: Picture) -> None:
    """Write a picture as JPEG; its folder is made if needed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


def draw_clips(clips: Iterable[str], draw: Callable[[str], Sequence[Path]]) -> None:
    """Draw the pictures of sequences, and say which files; those that are not there are told on stderr."""
    for clip in clips:
        try:
            paths = draw(clip)
        except MissingClip as err:
            print(f"{clip}: {err}", file=sys.stderr)
            continue
        print(f"{clip}: " + (", ".join(map(str, paths)) or "no model that can be trusted"), flush=True)


def plot_by_frame(path: Path, title: str, lines: Sequence[Line]) -> None:
    """Plot PSNR by frame."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    figure = Figure(figsize=(8.0, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for line in lines:
        colour = COLOURS[line.colour]
        peaks = dict(line.peaks or {})
        for number, part in enumerate(_parts(line)):
            axes.plot(
                list(part),
                list(part.values()),
                line.style,
                color=colour,
                marker=".",
                markersize=5,
                linewidth=1.3,
                label=line.label if number == 0 else None,
            )
        axes.plot(list(peaks), list(peaks.values()), "D", color=colour, markersize=4)
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("frame")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylabel("luma PSNR [dB]")
    axes.grid(color="#dddddd", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_output(path) as temporary:
        figure.savefig(temporary, format="png", dpi=DPI)


def _parts(line: Line) -> list[dict[int, float]]:
    """Cut a line at its key frames, unless it goes through them."""
    if line.peaks:
        return [dict(sorted({**line.points, **line.peaks}.items()))]
    parts: dict[int, dict[int, float]] = {}
    for number, frame in enumerate(sorted(line.points)):
        # Without gaps the difference of frame and number is the same.
        part = frame - number if line.gop is None else frame // line.gop
        parts.setdefault(part, {})[frame] = line.points[frame]
    return list(parts.values())


def pictures_command(
    prog: str, description: str, examples: str, pictures: Mapping[str, Callable[[], list[Path]]]
) -> Callable[..., int]:
    """Make the `main` of a command that draws pictures by name."""

    def _parser() -> argparse.ArgumentParser:
        parser = cli.ArgumentParser(prog, description, examples)
        parser.add_argument("--name", choices=pictures, help="only these")
        return parser

    def _draw(arguments: argparse.Namespace) -> int:
        draw_clips([arguments.name] if arguments.name else list(pictures), lambda name: pictures[name]())
        return 0

    return cli.command(prog, _parser, _draw)
