"""Command ``dvc-sequences``: list the test material, tell about it, render scenes."""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NoReturn

from dvc.errors import DvcError

EXAMPLES = """examples:
  dvc-sequences list
  dvc-sequences info street
  dvc-sequences render street --out street.mkv
  dvc-sequences render statue --out statue.y4m --size 176x144 --frames 25 --noise 1.5
  dvc-sequences render stairway --out s.mkv --depth s_depth --cameras s_cameras.json --jobs 4
"""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}\n")


def size(text: str) -> tuple[int, int]:
    """Read ``WIDTHxHEIGHT``."""
    words = text.lower().split("x")
    if len(words) != 2 or not all(word.isdecimal() and int(word) > 0 for word in words):
        raise argparse.ArgumentTypeError(f"{text!r} is not a size; write it as 352x288")
    return int(words[0]), int(words[1])


def whole(lowest: int) -> Callable[[str], int]:
    """Return a reader of integers that are not below `lowest`."""

    def read(text: str) -> int:
        if not text.isdecimal() or int(text) < lowest:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {lowest}")
        return int(text)

    return read


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    top = _Parser(
        prog="dvc-sequences",
        description="Test material: rendered scenes with exact geometry, and the video files of $DVC_DATA.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = top.add_subparsers(dest="command", required=True, metavar="{list,info,render}")
    listing = commands.add_parser("list", help="list all sequences and what each is for")
    listing.add_argument("--json", action="store_true", help="write JSON")
    info = commands.add_parser("info", help="tell about one sequence")
    info.add_argument("name", metavar="NAME", help="name in the list, or a video file")
    info.add_argument("--json", action="store_true", help="write JSON")
    _add_render(commands.add_parser("render", help="render a scene to a video file"))
    return top


def _add_render(render: argparse.ArgumentParser) -> None:
    render.add_argument("name", metavar="NAME", help="a rendered scene: street, stairway or statue")
    render.add_argument(
        "--out", required=True, metavar="FILE", help="video to write: .mkv (FFV1), .y4m or .mp4"
    )
    render.add_argument("--size", type=size, default=(352, 288), metavar="WxH", help="pixels (352x288)")
    render.add_argument("--frames", type=whole(1), metavar="N", help="length (50)")
    render.add_argument("--start", type=whole(0), default=0, metavar="K", help="first frame (0)")
    render.add_argument("--seed", type=whole(0), default=0, help="textures, plants, tremor, noise (0)")
    render.add_argument(
        "--noise", type=float, default=0.0, metavar="SIGMA", help="sensor noise, luma levels (0)"
    )
    render.add_argument("--depth", metavar="DIR", help="folder for one PFM depth map per frame, metres")
    render.add_argument("--cameras", metavar="FILE.json", help="file for K and cam_from_world of all frames")
    render.add_argument("--jobs", type=whole(1), default=1, metavar="N", help="frames rendered at once (1)")


def run_list(options: argparse.Namespace) -> None:
    """Write the catalogue to standard output."""
    from sequences import catalogue

    found = catalogue.entries()
    if options.json:
        sys.stdout.write(json.dumps([entry.to_dict() for entry in found], indent=1) + "\n")
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    columns = [
        (title, value) for title, value in catalogue.FIELDS if title not in ("shows", "motion", "kind")
    ]
    for title, _ in columns:
        table.add_column(title, no_wrap=title != "purpose")
    for entry in found:
        table.add_row(*(value(entry) for _, value in columns))
    Console(file=sys.stdout, width=None if sys.stdout.isatty() else 200, highlight=False, markup=False).print(
        table
    )


def run_info(options: argparse.Namespace) -> None:
    """Write what is known of one sequence to standard output."""
    from sequences import catalogue

    entry = catalogue.entry(options.name)
    if options.json:
        sys.stdout.write(json.dumps(entry.to_dict(), indent=1) + "\n")
        return
    for title, value in catalogue.FIELDS:
        sys.stdout.write(f"{title + ':':14}{value(entry)}\n")
    if entry.path is not None:
        sys.stdout.write(f"{'path:':14}{entry.path}\n")


def run_render(options: argparse.Namespace) -> None:
    """Render a scene to files."""
    from sequences.sequence import RenderedSequence, render

    sequence = RenderedSequence(
        options.name,
        *options.size,
        start=options.start,
        num_frames=options.frames,
        seed=options.seed,
        noise_sigma=options.noise,
        jobs=options.jobs,
    )
    with progress_bar(sequence.name, sequence.num_frames) as progress, sequence:
        render(sequence, options.out, cameras=options.cameras, depth=options.depth, progress=progress)


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Callable[[int], None] | None]:
    """Show a bar on standard error while it is a terminal; yields what tells it how far things are."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(file=sys.stderr)) as bar:
        task = bar.add_task(title, total=total)
        yield lambda done: bar.update(task, completed=done)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status: 0, or 2 after one line on standard error."""
    options = parser().parse_args(argv)
    run = {"list": run_list, "info": run_info, "render": run_render}[options.command]
    try:
        run(options)
    except (DvcError, OSError) as err:
        sys.stderr.write(f"dvc-sequences: {' '.join(str(err).split())}\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("dvc-sequences: interrupted\n")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
