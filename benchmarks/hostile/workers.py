"""Decoding processes forked from one that has loaded all kernels: mutations end many of them."""

import multiprocessing
import os
import resource
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, cast
from unittest.mock import patch

import decoder.processes
from decoder.group import GroupDecoder
from decoder.group_tasks import DecodedGroup, GroupTask
from decoder.session import stream_tasks
from dvc.config import decode_config
from dvc.environment import baseline_environment
from dvc.memory import address_bytes
from dvc.stream import StreamReader

STREAMS = Path(__file__).resolve().parents[2] / "tests" / "golden" / "streams"
_WARMING = ("2d-qp-buffered", "2d-classical-buffered", "3d-te-no-feedback", "3d-td-luma-buffered")
_LOADED = "benchmarks.hostile.loaded"


class ForkedProcess(decoder.processes.DecodingProcess):
    """A decoding process that is there at once."""

    def _start(self, connection: "Connection[Any, Any]") -> "subprocess.Popen[bytes]":
        return cast("subprocess.Popen[bytes]", _Child(connection))


class _Child:
    """A forked process with the methods of `Popen`."""

    def __init__(self, connection: "Connection[Any, Any]") -> None:
        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        most = limit if limit == resource.RLIM_INFINITY else limit - address_bytes()
        context = multiprocessing.get_context("forkserver")
        self._child = context.Process(target=_serve, args=(connection, most), daemon=True)
        self._child.start()

    def poll(self) -> int | None:
        return self._child.exitcode

    def wait(self, timeout: float | None = None) -> int:
        self._child.join(timeout)
        if self._child.exitcode is None:
            raise subprocess.TimeoutExpired("decoder.processes", timeout or 0.0)
        return self._child.exitcode

    def kill(self) -> None:
        self._child.kill()


def _serve(connection: "Connection[Any, Any]", most: int) -> None:
    """Decode within the limit of additional memory of the process that starts this one."""
    if most != resource.RLIM_INFINITY:
        resource.setrlimit(resource.RLIMIT_AS, (address_bytes() + most, resource.RLIM_INFINITY))
    decoder.processes.serve(connection)


@contextmanager
def forked_workers() -> Iterator[None]:
    """Fork decoding processes during a block."""
    with (
        patch.dict(os.environ, baseline_environment()),
        patch.object(decoder.processes, "DecodingProcess", ForkedProcess),
    ):
        multiprocessing.set_forkserver_preload([_LOADED])
        forkserver.ensure_running()
        try:
            yield
        finally:
            decoder.processes.stop_idle_processes()


def load_kernels() -> None:
    """Decode in this process, so that forked ones have all kernels."""
    for name in _WARMING:
        with suppress(Exception), StreamReader(STREAMS / f"{name}.dvc") as reader:
            for task in stream_tasks(reader.config, reader):
                _decoded(task)


def _decoded(task: GroupTask) -> DecodedGroup:
    return GroupDecoder(decode_config(task.config)).decode(task)
