"""Panels and correlation noise of pictures, and the command that draws them."""

import argparse
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.results.harness import Missing
from dvc import cli

PANEL_WIDTH = 528
QUALITY = 80
_BANNER = 30
Picture = NDArray[np.uint8]
Floats = NDArray[np.float64]


def panel(plane: NDArray[np.uint8], title: str) -> Picture:
    """Scale a picture to the width of a panel and put a title above it."""
    colour = plane if plane.ndim == 3 else np.repeat(plane[:, :, None], 3, axis=2)
    height = round(PANEL_WIDTH * colour.shape[0] / colour.shape[1])
    scaled = cv2.resize(colour, (PANEL_WIDTH, height), interpolation=cv2.INTER_CUBIC)
    banner = np.full((_BANNER, PANEL_WIDTH, 3), 255, dtype=np.uint8)
    cv2.putText(banner, title, (4, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.52, (30, 30, 30), 1, cv2.LINE_AA)
    framed: Picture = np.vstack([banner, np.asarray(scaled, np.uint8)])
    return framed


def correlation_noise(predicted: Floats, original: NDArray[np.uint8]) -> Picture:
    """Show the difference of side information and frame, grey if there is none."""
    return np.clip(128.0 + 2.0 * (predicted - original), 0, 255).astype(np.uint8)


def write_picture(path: Path, picture: Picture) -> None:
    """Write a picture as JPEG; its folder is made if needed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


def draw_clips(clips: Iterable[str], draw: Callable[[str], Sequence[Path]]) -> None:
    """Draw the pictures of sequences and print their files; report missing sequences on stderr."""
    for clip in clips:
        try:
            paths = draw(clip)
        except Missing as err:
            print(f"{clip}: {err}", file=sys.stderr)
            continue
        print(f"{clip}: " + (", ".join(map(str, paths)) or "no model that can be trusted"), flush=True)


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
