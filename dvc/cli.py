"""Common parts of all commands: one-line errors with exit status 2, help with examples, progress bars."""

import argparse
import contextlib
import io
import json
import logging
import math
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple, NoReturn, Protocol

from dvc.environment import COMPILATION_NOTICE
from dvc.errors import ConfigError, DvcError, PartialOutputError

EXIT_BAD_INPUT = 2
EXIT_PARTIAL = 3
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143
COMPILING = "{}: compiling kernels, once, which takes up to a minute (dvc-compile does so for all programs)"


class ArgumentParser(argparse.ArgumentParser):
    """A parser that reports errors in one line on stderr, and ends its help with examples."""

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
        if " " not in prog:  # not of subcommands
            text = "print the versions of the program and of its main libraries, and exit"
            self.add_argument("--version", action=_PrintVersions, nargs=0, help=text)

    def error(self, message: str) -> NoReturn:
        """Print one line and exit with status 2."""
        self.exit(EXIT_BAD_INPUT, f"{self.prog}: {one_line(message)}\n")


class _PrintVersions(argparse.Action):
    """Looks up the versions when they are requested."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from dvc import __version__
        from dvc.versions import library_versions

        libraries = [f"{name} {version}" for name, version in library_versions().items()]
        sys.stdout.write(f"{parser.prog} of dvc3d {__version__}; {', '.join(libraries)}\n")
        parser.exit()


def one_line(text: object) -> str:
    """Fold a message into one line; control characters, such as escapes, become question marks."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(str(text).split()))


class _OneLine(logging.Formatter):
    """Log records in one line."""

    def format(self, record: logging.LogRecord) -> str:
        return one_line(super().format(record))


class Terminated(KeyboardInterrupt):
    """SIGTERM: like an interrupt, but from elsewhere than the terminal."""


def _terminate(_number: int, _frame: FrameType | None) -> NoReturn:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # open files are being removed
    raise Terminated


@contextlib.contextmanager
def stopping_at_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Call a function at an interrupt or SIGTERM while the block continues; a second signal aborts it."""

    def _stop(number: int, _: FrameType | None) -> None:
        signal.signal(number, signal.default_int_handler)
        stop()

    numbers = [n for n in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(n) != signal.SIG_IGN]
    if threading.current_thread() is not threading.main_thread():
        numbers = []
    before = {number: signal.signal(number, _stop) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run(prog: str, command: Callable[[], int]) -> int:
    """Run a command; expected failures become one line on stderr and an exit status."""
    log = logging.StreamHandler(sys.stderr)
    log.setFormatter(_OneLine(f"{prog}: %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[log])
    is_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, _terminate) if is_main else None
    try:
        return command()
    except PartialOutputError as err:
        status, message = EXIT_PARTIAL, one_line(err)
    except DvcError as err:
        status, message = EXIT_BAD_INPUT, one_line(err)
    except OSError as err:
        status = EXIT_BAD_INPUT
        message = one_line(f"{err.filename}: {err.strerror}" if err.filename else err.strerror or err)
    except MemoryError:
        status, message = EXIT_BAD_INPUT, "out of memory"
    except Terminated:
        status, message = EXIT_TERMINATED, "terminated"
    except KeyboardInterrupt:
        status, message = EXIT_INTERRUPTED, "interrupted"
    finally:
        if is_main:
            signal.signal(signal.SIGTERM, before)
    sys.stderr.write(f"{prog}: {message}\n")
    return status


def command(
    prog: str,
    parser: Callable[[], argparse.ArgumentParser],
    work: Callable[[argparse.Namespace], int],
    *,
    has_subcommands: bool = False,
    extra: str | None = None,
) -> Callable[..., int]:
    """Make the `main` of a command; `extra` names the packages that it needs besides those of a camera."""

    def _work(arguments: argparse.Namespace) -> int:
        try:
            return work(arguments)
        except ModuleNotFoundError as err:
            package = (err.name or "").partition(".")[0]
            if extra is None or package in ("", "dvc", "encoder", "decoder", "sequences", "sfm"):
                raise
            raise DvcError(f"needs {package}: pip install 'dvc3d[{extra}]'") from err

    def _main(argv: Sequence[str] | None = None) -> int:
        if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
            sys.stdout.reconfigure(errors="backslashreplace")  # names of files may be no text
        built = parser()
        arguments = built.parse_args(argv) if has_subcommands else built.parse_intermixed_args(argv)
        before = os.environ.get(COMPILATION_NOTICE)  # empty if the command that started this one is quiet
        is_quiet = getattr(arguments, "quiet", False) or before == ""
        os.environ[COMPILATION_NOTICE] = "" if is_quiet else COMPILING.format(prog)
        try:
            return run(prog, lambda: _work(arguments))
        finally:
            del os.environ[COMPILATION_NOTICE]
            if before is not None:
                os.environ[COMPILATION_NOTICE] = before

    return _main


class Advance(Protocol):
    """Advances a progress bar, and shows a note next to it."""

    def __call__(self, steps: int, note: str = "") -> None:
        """Move it on."""


@contextlib.contextmanager
def progress_bar(label: str, total: int | None, quiet: bool = False) -> Iterator["Advance"]:
    """Show a progress bar on stderr, with steps a second, while the block runs, if that is a terminal."""
    if quiet or not sys.stderr.isatty():
        yield lambda steps, note="": None
        return
    from rich import progress
    from rich.console import Console

    class SpeedColumn(progress.ProgressColumn):
        def render(self, task: progress.Task) -> str:
            return f"{task.completed / task.elapsed:.3g}/s" if task.elapsed and task.completed else ""

    columns = (
        progress.TextColumn(label),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
        SpeedColumn(),
        progress.TextColumn("{task.fields[note]}"),
    )
    with progress.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=total, note="")
        yield lambda steps, note="": bar.update(task, advance=steps, note=note)


def parse_size(text: str) -> tuple[int, int]:
    """Read a picture size."""
    width, cross, height = text.lower().partition("x")
    if not cross or not (width.isdecimal() and height.isdecimal()) or 0 in (int(width), int(height)):
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT such as 352x288, got {text!r}")
    return int(width), int(height)


def parse_frame_rate(text: str) -> Fraction:
    """Read a frame rate."""
    from dvc.video import exact_frame_rate

    try:
        return exact_frame_rate(Fraction(text) if "/" in text else float(text))
    except (ValueError, ZeroDivisionError) as err:
        message = f"expected a frame rate such as 30 or 30000/1001, got {text!r}"
        raise argparse.ArgumentTypeError(message) from err


def parse_bits(text: str) -> int:
    """Read a number of bits such as 300000, 300k or 1.5M."""
    factors = {"k": 10**3, "M": 10**6}
    digits, factor = (text[:-1], factors[text[-1]]) if text[-1:] in factors else (text, 1)
    try:
        return max(round(parse_positive(digits) * factor), 1)
    except (argparse.ArgumentTypeError, OverflowError):
        raise argparse.ArgumentTypeError(
            f"expected bits above 0 such as 300000, 300k or 1.5M, got {text!r}"
        ) from None


def parse_number(text: str) -> float:
    """Read a finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected a number, got {text!r}")
    return value


def parse_positive(text: str) -> float:
    """Read a positive number."""
    value = parse_number(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"expected a positive number, got {text!r}")
    return value


def integer(low: int, high: int) -> Callable[[str], int]:
    """Return a reader of whole numbers in a range, for `add_argument(type=...)`."""

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
    """Add an option that is a whole number."""
    help_text = text if default is None else f"{text}; default: %(default)s"
    group.add_argument(option, type=integer(*bounds), default=default, metavar=metavar, help=help_text)


def add_live(group: argparse._ActionsContainer, option: str, text: str) -> None:
    """Add the options of a live run: the address, and how long to wait for the other end."""
    group.add_argument(option, metavar="HOST:PORT", help=text)
    group.add_argument(
        "--token-file",
        metavar="FILE",
        help="shared secret of 16 bytes or more, which is sent inside TLS: the encoder serves only a decoder"
        " with the same token; requires TLS",
    )
    group.add_argument(
        "--insecure",
        action="store_true",
        help="allow plain TCP through a network: anyone may read and change the data",
    )
    silence = "time after which the connection to a silent peer is lost, in seconds"
    add_integer(group, "--timeout", (1, 86400), silence, default=30, metavar="S")
    patience = (
        "time for the decoder to replace a lost connection, in seconds: the run continues after the last"
        " group of pictures that is written; 0: a lost connection ends the run"
    )
    add_integer(group, "--patience", (0, 86400), patience, default=30, metavar="S")


class Constraint(NamedTuple):
    """Requirements of an option: one of the options that it needs, none of those that it excludes.

    A name such as "--codec 2d" means the option with this value.
    """

    option: str
    needs: tuple[str, ...] = ()
    excludes: tuple[str, ...] = ()
    why: str = ""


def is_given(arguments: argparse.Namespace, name: str) -> bool:
    """Return whether an option is given, or has the value after its name."""
    option, _, value = name.partition(" ")
    given = getattr(arguments, option.strip("-").replace("-", "_").lower())
    return str(given) == value if value else given is not None and given is not False


def check_constraints(arguments: argparse.Namespace, constraints: Iterable[Constraint]) -> None:
    """Refuse options that contradict each other, before any work is done."""
    for option, needs, excludes, why in constraints:
        if not is_given(arguments, option):
            continue
        reason = f": {why}" if why else ""
        if needs and not any(is_given(arguments, name) for name in needs):
            raise ConfigError(f"{option} requires {' or '.join(needs)}{reason}")
        for name in excludes:
            if is_given(arguments, name):
                raise ConfigError(f"{option} excludes {name}{reason}")


def write_json(path: str | Path, values: object) -> None:
    """Write a JSON file in one piece, or to standard output."""
    write_text(path, json.dumps(values, indent=1, allow_nan=False) + "\n")


def write_text(path: str | Path, text: str) -> None:
    """Write a file in one piece, or to standard output."""
    if str(path) == "-":
        sys.stdout.write(text)
        return
    from dvc.files import atomic_output

    with atomic_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def with_contents(inputs: Sequence[str | Path]) -> list[str | Path]:
    """Return inputs, and the files that folders among them hold."""
    held = (path for name in inputs if Path(name).is_dir() for path in Path(name).iterdir())
    return [*inputs, *held]


def check_outputs(inputs: list[str | Path], outputs: list[str | Path]) -> None:
    """Refuse to overwrite an input, and to write one file twice, before any work is done."""
    from dvc.files import same_file

    for position, output in enumerate(outputs):
        if any(same_file(output, other) for other in [*inputs, *outputs[:position]]):
            raise ConfigError(f"output {output} is also an input or another output")
        if Path(output).is_dir():
            raise ConfigError(f"output {output} is a folder")
        if not Path(output).absolute().parent.is_dir():
            raise ConfigError(f"output {output}: its folder does not exist")
