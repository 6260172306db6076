"""Command `python -m benchmarks.pictures`: pictures of docs/, and those of real clips in results/."""

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from benchmarks.pictures import dibr, rendered, scene, stereo
from benchmarks.results.harness import Missing
from dvc import cli

PROG = "python -m benchmarks.pictures"
EXAMPLES = """\
  python -m benchmarks.pictures                all of them; many minutes
  python -m benchmarks.pictures scene          those of docs/side_information.md
  python -m benchmarks.pictures stereo-toy     one
"""
PICTURES: dict[str, Callable[[], list[Path]]] = {
    "first": rendered.draw_first,
    **{f"scene-{clip}": partial(scene.draw, clip) for clip in scene.SHOWN},
    "map": rendered.draw_map,
    **{f"stereo-{name}": draw for name, draw in stereo.PICTURES.items()},
    **{f"dibr-{name}": draw for name, draw in dibr.PICTURES.items()},
}
"""Functions that draw pictures and return their files, by name."""
ROOMS = {name.partition("-")[0]: None for name in PICTURES}


def _parser() -> argparse.ArgumentParser:
    parser = cli.ArgumentParser(PROG, "Draw the pictures of the documents.", EXAMPLES)
    names = {**ROOMS, **PICTURES}
    help_text = f"one of {', '.join(names)}; default: all"
    parser.add_argument("names", nargs="*", choices=[*names, []], metavar="NAME", help=help_text)
    return parser


def _draw(arguments: argparse.Namespace) -> int:
    for name, draw in PICTURES.items():
        if arguments.names and not {name, name.partition("-")[0]} & {*arguments.names}:
            continue
        try:
            paths = draw()
        except Missing as err:
            print(f"{name}: {err}", file=sys.stderr)
            continue
        print(f"{name}: " + (", ".join(map(str, paths)) or "no model that can be trusted"), flush=True)
    return 0


main = cli.command(PROG, _parser, _draw)

if __name__ == "__main__":
    sys.exit(main())
