"""What all commands share: one-line errors with exit status 2, help with examples, progress bars."""

import argparse
import contextlib
import json
import logging
import math
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, NoReturn

from dvc.errors import ConfigError, DvcError

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


class ArgumentParser(argparse.ArgumentParser):
    """A parser whose errors are one line on stderr, and whose help ends with examples.

    Parameters
    ----------
    prog, description : str
        As in `argparse.ArgumentParser`.
    examples : str, optional
        Shown as they stand at the end of the help.
    **options
        Passed on.
    """

    def __init__(self, prog: str, description: str, examples: str = "", **options: Any) -> None:
        super().__init__(
            prog=prog,
            description=description,
            epilog=f"examples:\n{examples}" if examples else None,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            **options,
        )
        # Values such as -1,2 and -4:3 are no options.
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message: str) -> NoReturn:
        """Print one line and exit with status 2.

        Parameters
        ----------
        message : str
            What is wrong.
        """
        self.exit(EXIT_BAD_INPUT, f"{self.prog}: {one_line(message)}\n")


def one_line(text: object) -> str:
    """Fold a message into one line.

    Parameters
    ----------
    text : object
        Anything with a `str`.

    Returns
    -------
    str
        Its words, separated by single spaces.
    """
    return " ".join(str(text).split())


def run(prog: str, command: Callable[[], int]) -> int:
    """Run a command; expected failures become one line on stderr and an exit status.

    Parameters
    ----------
    prog : str
        Name shown before the message.
    command : callable
        Does the work and returns the exit status.

    Returns
    -------
    int
        That status; 2 for bad input, 130 for an interrupt from the keyboard.
    """
    logging.basicConfig(level=logging.WARNING, format=f"{prog}: %(message)s", stream=sys.stderr)
    try:
        return command()
    except DvcError as err:
        message = one_line(err)
    except OSError as err:
        message = one_line(f"{err.filename}: {err.strerror}" if err.filename else err)
    except MemoryError:
        message = "out of memory"
    except KeyboardInterrupt:
        sys.stderr.write(f"{prog}: interrupted\n")
        return EXIT_INTERRUPTED
    sys.stderr.write(f"{prog}: {message}\n")
    return EXIT_BAD_INPUT


def command(
    prog: str,
    parser: Callable[[], argparse.ArgumentParser],
    work: Callable[[argparse.Namespace], int],
    *,
    has_subcommands: bool = False,
) -> Callable[..., int]:
    """Make the `main` of a command.

    Parameters
    ----------
    prog : str
        Name shown before messages.
    parser : callable
        Builds the parser; options and file names may stand in any order.
    work : callable
        Does what the arguments say and returns the exit status.
    has_subcommands : bool, optional
        Whether the parser has subcommands; their options and file names may stand in any order anyway.

    Returns
    -------
    callable
        Takes the arguments, by default those of the process, and returns the exit status: that of `work`, or
        2 for bad input.
    """

    def _main(argv: Sequence[str] | None = None) -> int:
        built = parser()
        arguments = built.parse_args(argv) if has_subcommands else built.parse_intermixed_args(argv)
        return run(prog, lambda: work(arguments))

    return _main


@contextlib.contextmanager
def progress_bar(label: str, total: int | None, quiet: bool = False) -> Iterator[Callable[[int], None]]:
    """Show a progress bar on stderr while the block runs, if that is a terminal.

    Parameters
    ----------
    label : str
        What is going on.
    total : int or None
        Steps in all; None where nobody knows.
    quiet : bool, optional
        Show nothing.

    Yields
    ------
    callable
        Call it with the number of steps that have just been finished.
    """
    if quiet or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn(label),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=total)
        yield lambda steps: bar.advance(task, steps)


def parse_size(text: str) -> tuple[int, int]:
    """Read a picture size.

    Parameters
    ----------
    text : str
        WIDTHxHEIGHT.

    Returns
    -------
    tuple of int
        Width and height in pixels.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is something else.
    """
    width, cross, height = text.lower().partition("x")
    if not cross or not (width.isdecimal() and height.isdecimal()) or 0 in (int(width), int(height)):
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT such as 352x288, got {text!r}")
    return int(width), int(height)


def parse_frame_rate(text: str) -> Fraction:
    """Read a frame rate.

    Parameters
    ----------
    text : str
        Frames per second, such as 30, 29.97 or 30000/1001.

    Returns
    -------
    Fraction
        Frames per second.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is no rate between 10**-6 and 10**6.
    """
    from dvc.video import exact_frame_rate

    try:
        return exact_frame_rate(Fraction(text) if "/" in text else float(text))
    except (ValueError, ZeroDivisionError) as err:
        message = f"expected a frame rate such as 30 or 30000/1001, got {text!r}"
        raise argparse.ArgumentTypeError(message) from err


def parse_number(text: str) -> float:
    """Read a finite number.

    Parameters
    ----------
    text : str
        The number.

    Returns
    -------
    float
        Its value.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is something else.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected a number, got {text!r}")
    return value


def parse_positive(text: str) -> float:
    """Read a positive number.

    Parameters
    ----------
    text : str
        The number.

    Returns
    -------
    float
        Its value.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is something else.
    """
    value = parse_number(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"expected a positive number, got {text!r}")
    return value


def integer(low: int, high: int) -> Callable[[str], int]:
    """Return a reader of whole numbers in a range, for `add_argument(type=...)`.

    Parameters
    ----------
    low, high : int
        Smallest and largest value accepted.

    Returns
    -------
    callable
        Text to int; raises `argparse.ArgumentTypeError` outside the range.
    """

    def _read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"expected a whole number from {low} to {high}, got {text!r}")
        return value

    return _read


def add_integer(
    group: argparse._ActionsContainer,
    option: str,
    bounds: tuple[int, int],
    text: str,
    *,
    default: int | None = None,
    metavar: str = "N",
) -> None:
    """Add an option that is a whole number.

    Parameters
    ----------
    group : ArgumentParser or group of one
        Where to add it.
    option : str
        Its name with dashes.
    bounds : tuple of two int
        Smallest and largest value accepted.
    text : str
        Help; the default is told after it.
    default : int, optional
        Value where the option is not given.
    metavar : str, optional
        Name of the number in the help.
    """
    told = text if default is None else f"{text}; default: %(default)s"
    group.add_argument(option, type=integer(*bounds), default=default, metavar=metavar, help=told)


def add_live(group: argparse._ActionsContainer, option: str, text: str) -> None:
    """Add the options of a live run: the address, and how long to wait for the other end.

    Parameters
    ----------
    group : ArgumentParser or group of one
        Where to add them.
    option : str
        Option of the address, with dashes.
    text : str
        Its help.
    """
    group.add_argument(option, metavar="HOST:PORT", help=text)
    patience = "patience with a silent peer, in seconds"
    add_integer(group, "--timeout", (1, 86400), patience, default=30, metavar="S")


def write_json(path: str | Path, values: object) -> None:
    """Write a JSON file in one piece.

    Parameters
    ----------
    path : str or Path
        Name of the file; ``-`` for standard output.
    values : object
        JSON-safe values; infinities and NaN are refused.

    Raises
    ------
    DvcError
        If the file cannot be made there.
    """
    text = json.dumps(values, indent=1, allow_nan=False) + "\n"
    if str(path) == "-":
        sys.stdout.write(text)
        return
    from dvc.files import atomic_output

    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def check_outputs(inputs: list[str | Path], outputs: list[str | Path]) -> None:
    """Refuse to overwrite what is being read, and to write one file twice, before any work is done.

    Parameters
    ----------
    inputs, outputs : list of str or Path
        Names of files.

    Raises
    ------
    ConfigError
        If an output is an input or another output, is a folder, or its folder does not exist.
    """
    from dvc.files import same_file

    for position, output in enumerate(outputs):
        if any(same_file(output, other) for other in [*inputs, *outputs[:position]]):
            raise ConfigError(f"output {output} is also an input or another output")
        if Path(output).is_dir():
            raise ConfigError(f"output {output} is a folder")
        if not Path(output).absolute().parent.is_dir():
            raise ConfigError(f"output {output}: its folder does not exist")
