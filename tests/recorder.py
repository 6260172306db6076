"""Says which kernels a run calls from Python, and with which types, as lines for `dvc.compile_ahead`.

`python -m tests.recorder decoder STREAM`, or `python -m tests.recorder encoder VIDEO OPTION...`; with `live`
in place of `encoder` it answers a decoder. After `--` come a stream or video and options of a further run,
of which only those calls are told that were not made before.
"""

import inspect
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from numba.core import dispatcher

PATIENCE_S = 300.0
USED: dict[str, None] = {}
DISPATCHER: Any = dispatcher.Dispatcher
_compile = DISPATCHER._compile_for_args


def text(kind: Any) -> str:
    """Write a type as `dvc._jit.compile_for` reads it."""
    if not hasattr(kind, "instance_class"):
        return repr(kind)
    named = kind.instance_class
    return f"{named.__module__}.{named.__qualname__}({', '.join(map(text, kind.types))})"


def name(function: Any) -> str:
    """Write how a kernel is got: by its name, or from a function that makes it."""
    maker, local, _ = function.__qualname__.partition(".<locals>")
    if not local:
        return str(maker)
    cells = inspect.getclosurevars(function).nonlocals
    parameters = inspect.signature(getattr(sys.modules[function.__module__], maker)).parameters
    return f"{maker}({','.join(str(cells[parameter]) for parameter in parameters)})"


def record(kernel: Any, *arguments: object) -> Any:
    """Note the types of a call that numba has no code for yet in this process, and get it."""
    types = ", ".join(text(kernel.typeof_pyval(argument)) for argument in arguments)
    USED[f"{kernel.py_func.__module__} {name(kernel.py_func)} ({types},)"] = None
    return _compile(kernel, *arguments)


def decode(path: str) -> None:
    """Decode a stream as a decoding process does, with tasks that come from another."""
    from decoder.group import GroupDecoder
    from decoder.session import stream_tasks
    from decoder.tasks import following
    from dvc.stream import StreamReader

    with StreamReader(path) as reader:
        decoder: Any = GroupDecoder(reader.config)
        for chain in stream_tasks(reader.config, reader):
            group = None
            for task in chain:
                group = decoder.decode(pickle.loads(pickle.dumps(following(task, group))))


def encode(*arguments: str) -> None:
    """Encode a video."""
    from encoder.__main__ import main

    with tempfile.TemporaryDirectory() as folder:
        assert main([arguments[0], str(Path(folder) / "stream.dvc"), *arguments[1:], "--quiet"]) == 0


def serve(*arguments: str) -> None:
    """Encode a video for a live decoder, which is a process of its own."""
    from dvc.feedback import KEEP_ALIVE, listen
    from dvc.video import open_video
    from encoder import live, options

    parsed = options.parser().parse_args([arguments[0], "--serve", "127.0.0.1:0", *arguments[1:]])
    with tempfile.TemporaryDirectory() as folder, listen() as listener, open_video(arguments[0]) as frames:
        output = str(Path(folder) / "video.y4m")
        command = [sys.executable, "-m", "decoder", "--connect", listener.name, output, "--quiet"]
        with subprocess.Popen(command) as decoder:
            connection = listener.accept(silence_timeout_s=PATIENCE_S)
            with connection, connection.kept_alive(KEEP_ALIVE):
                live.serve(options.session(parsed, frames.info), frames, connection, lambda _: None)
            assert decoder.wait() == 0


def runs(arguments: Sequence[str]) -> Iterator[list[str]]:
    """Part the arguments at each `--`."""
    for separates, run in groupby(arguments, "--".__eq__):
        if not separates:
            yield list(run)


if __name__ == "__main__":
    DISPATCHER._compile_for_args = record
    work: dict[str, Any] = {"decoder": decode, "encoder": encode, "live": serve}
    for run in runs(sys.argv[2:]):
        work[sys.argv[1]](*run)
    sys.stdout.write("".join(f"{line}\n" for line in USED))
