"""Command ``dvc-sequences``: list and describe the test material, render scenes, fetch real clips."""

import argparse
import json
import sys
from pathlib import Path

from dvc import cli

PROG = "dvc-sequences"
MAX_NUMBER = 2**31 - 1
EXAMPLES = """\
  dvc-sequences list
  dvc-sequences info street
  dvc-sequences render street --out street.mkv
  dvc-sequences render statue --out statue.y4m --size 176x144 --frames 25 --noise 1.5
  dvc-sequences render toy --out toy
  dvc-sequences render stairway --out s.mkv --depth s_depth --cameras s_cameras.json --jobs 4
  dvc-sequences fetch box river --out clips
"""
FETCH_EXAMPLES = """\
  dvc-sequences fetch box river --out clips
  dvc-sequences fetch --from http://127.0.0.1:8000 --out clips
  dvc-sequences fetch box --from downloads --out clips
"""


def _parser() -> argparse.ArgumentParser:
    from sequences.clip_sources import GITHUB, NOT_REPEATABLE, SOURCES

    description = "Test material: rendered scenes with exact geometry, and the video files of $DVC_DATA."
    parser = cli.ArgumentParser(PROG, description, EXAMPLES)
    commands = parser.add_subparsers(dest="command", required=True, metavar="{list,info,render,fetch}")

    def command(name: str, text: str) -> argparse.ArgumentParser:
        description = f"{text[0].upper()}{text[1:]}."
        return commands.add_parser(name, prog=f"{PROG} {name}", description=description, help=text)

    listing = command("list", "list all sequences and their purposes")
    info = command("info", "describe one sequence")
    info.add_argument("name", metavar="NAME", help="name in the list, or a video file")
    for each in (listing, info):
        each.add_argument("--json", action="store_true", help="write JSON")

    render = command("render", "render a scene to a video file")
    add = render.add_argument
    scenes = "street, stairway, statue, rounds; or toy, for a camera array"
    add("name", metavar="NAME", help=scenes)
    out = "video: .mkv (FFV1), .y4m or .mp4; for toy, a folder for pictures, depth and cameras"
    add("--out", required=True, metavar="FILE", help=out)
    add("--size", type=cli.parse_size, metavar="WxH", help="pixels; default: 352x288, for toy 320x240")
    cli.add_integer(render, "--frames", (1, MAX_NUMBER), "length; default: the usual one of the scene")
    cli.add_integer(render, "--start", (0, MAX_NUMBER), "first frame", default=0, metavar="K")
    cli.add_integer(render, "--seed", (0, MAX_NUMBER), "textures, plants, tremor, noise", default=0)
    add("--noise", type=float, default=0.0, metavar="SIGMA", help="sensor noise, luma levels; default: 0")
    add("--depth", metavar="DIR", help="folder for one PFM depth map per frame, metres")
    add("--cameras", metavar="FILE.json", help="file for K and cam_from_world of all frames")
    cli.add_integer(render, "--jobs", (1, 256), "frames rendered at once", default=1)

    fetch = command("fetch", "make the real test clips from their public sources")
    lines = [f"{name}: {source.uncertain}" for name, source in SOURCES.items() if source.uncertain]
    lines += [f"{name} cannot be made: {why}" for name, why in NOT_REPEATABLE.items()]
    notes = "\n".join(f"  {line}" for line in lines)
    fetch.epilog = f"notes on the sources:\n{notes}\n\nexamples:\n{FETCH_EXAMPLES}"
    names = f"any of {', '.join(SOURCES)}; default: all"
    fetch.add_argument("names", nargs="*", metavar="NAME", help=names)
    origin = (
        f"address or folder of REPOSITORY/COMMIT/PATH (a folder may also hold PATH itself); default: {GITHUB}"
    )
    fetch.add_argument("--from", dest="origin", default=GITHUB, metavar="URL", help=origin)
    fetch.add_argument("--out", required=True, metavar="DIR", help="folder for the clips NAME.mkv (FFV1)")
    return parser


def _list(arguments: argparse.Namespace) -> int:
    """Write the catalogue to standard output."""
    from sequences import catalogue

    entries = catalogue.entries()
    if arguments.json:
        sys.stdout.write(json.dumps([entry.to_dict() for entry in entries], indent=1) + "\n")
        return 0
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    columns = [field for field in catalogue.FIELDS if field[0] not in ("shows", "motion", "kind")]
    for title, _ in columns:
        table.add_column(title, no_wrap=title != "purpose")
    for entry in entries:
        table.add_row(*(value(entry) for _, value in columns))
    width = None if sys.stdout.isatty() else 200
    Console(file=sys.stdout, width=width, highlight=False, markup=False).print(table)
    return 0


def _info(arguments: argparse.Namespace) -> int:
    """Write one entry of the catalogue to standard output."""
    from sequences import catalogue

    entry = catalogue.entry(arguments.name)
    if arguments.json:
        sys.stdout.write(json.dumps(entry.to_dict(), indent=1) + "\n")
        return 0
    for title, value in catalogue.FIELDS:
        sys.stdout.write(f"{title + ':':14}{value(entry)}\n")
    if entry.path is not None:
        sys.stdout.write(f"{'path:':14}{entry.path}\n")
    return 0


def _render(arguments: argparse.Namespace) -> int:
    """Render a scene to files."""
    from dvc.errors import ConfigError
    from sequences.rendered_sequence import RenderedSequence, render, write_array
    from sequences.scene_layouts import ARRAY_SCENES, POSITIONS

    if arguments.name in ARRAY_SCENES:
        given = {
            "--frames": arguments.frames is not None,
            "--start": arguments.start > 0,
            "--noise": arguments.noise != 0.0,
            "--depth": arguments.depth is not None,
            "--cameras": arguments.cameras is not None,
        }
        for option in (option for option, is_given in given.items() if is_given):
            raise ConfigError(
                f"{option} applies to videos; {arguments.name} is a folder with depth and cameras"
            )
        size = arguments.size or (320, 240)
        with cli.progress_bar(arguments.name, len(POSITIONS)) as progress:
            write_array(arguments.name, arguments.out, *size, seed=arguments.seed, progress=progress)
        return 0
    sequence = RenderedSequence(
        arguments.name,
        *(arguments.size or (352, 288)),
        start=arguments.start,
        num_frames=arguments.frames,
        seed=arguments.seed,
        noise_sigma=arguments.noise,
        jobs=arguments.jobs,
    )
    with cli.progress_bar(sequence.name, sequence.num_frames) as progress, sequence:
        render(sequence, arguments.out, cameras=arguments.cameras, depth=arguments.depth, progress=progress)
    return 0


def _fetch(arguments: argparse.Namespace) -> int:
    """Make clips; report each failure in a line and continue with the next clip."""
    from dvc.errors import DvcError
    from sequences.fetch import chosen, fetch

    status, out = 0, Path(arguments.out)
    names = chosen(arguments.names)
    out.mkdir(exist_ok=True)
    for name in names:
        try:
            sys.stdout.write(f"{fetch(name, arguments.origin, out, cli.progress_bar)}\n")
        except DvcError as err:
            status = cli.EXIT_BAD_INPUT
            sys.stderr.write(f"{PROG}: {cli.one_line(err)}\n")
    return status


WORK = {"list": _list, "info": _info, "render": _render, "fetch": _fetch}
main = cli.command(PROG, _parser, lambda given: WORK[given.command](given), has_subcommands=True)

if __name__ == "__main__":
    sys.exit(main())
