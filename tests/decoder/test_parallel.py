"""Processes that decode: what is lent comes back, and what dies is said."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from decoder import parallel
from decoder.parallel import DecodingProcess, decode_groups, decoding_processes
from decoder.session import decode_stream
from dvc.errors import DvcError
from dvc.stream import StreamReader

STREAM = Path(__file__).parents[1] / "golden" / "streams" / "version_2" / "3d-td-all-punctured.dvc"

PROGRAM = """
import numpy as np
from decoder.session import decode_stream
from dvc.stream import StreamReader
np.linalg.svd(np.random.default_rng(1).normal(size=(9, 9)))
with StreamReader({path!r}) as reader:
    for group in decode_stream(reader.config, reader):
        print(group.first_index, group.record.digest)
"""


def digests(reader: StreamReader) -> list[str]:
    """Return what the program above prints."""
    return [f"{group.first_index} {group.record.digest}" for group in decode_stream(reader.config, reader)]


def test_a_program_that_has_loaded_libraries_decodes_alike() -> None:
    """An unguarded script on libraries of another processor, numpy in use, gets the frames of the stream."""
    environment = os.environ | {"OPENBLAS_CORETYPE": "Sandybridge", "NPY_DISABLE_CPU_FEATURES": "X86_V4"}
    command = [sys.executable, "-c", PROGRAM.format(path=str(STREAM))]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with StreamReader(STREAM) as reader:
        assert done.stdout.splitlines() == digests(reader)


def test_idle_processes_are_lent_again() -> None:
    """A second sequence is decoded by the process of the first."""
    with decoding_processes(1) as (first,):
        pass
    with decoding_processes(2) as (again, other):
        assert again is first
        assert other is not first
        assert other.alive


def test_busy_processes_do_not_come_back() -> None:
    """A process that is in the middle of something when its user leaves is stopped."""
    with decoding_processes(1) as (process,):
        process.busy = True
    assert not process.alive


def test_a_killed_process_is_said_and_replaced() -> None:
    """Decoding ends in one error, and the next sequence gets another process."""

    def decode() -> None:
        with StreamReader(STREAM) as reader:
            for group in decode_stream(reader.config, reader):
                if group.first_index == 0:
                    for process in started:
                        os.kill(process._process.pid, signal.SIGKILL)
                        process._process.wait()

    started: list[DecodingProcess] = []
    with decoding_processes(1) as processes:
        started.extend(processes)
    with pytest.raises(DvcError, match="decoding process was killed"):
        decode()
    assert not any(process in parallel._idle for process in started)
    with StreamReader(STREAM) as reader:
        assert len(digests(reader)) == 2


def test_no_groups_need_no_answer() -> None:
    """Nothing is decoded where there is nothing."""
    assert list(decode_groups([], 1)) == []


def test_features_that_are_not_there_are_no_news(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What OpenCV says of features that it is to do without, but does not have, reaches no terminal."""
    environment = parallel.baseline_environment() | {"OPENCV_CPU_DISABLE": "AVX,NO-SUCH-FEATURE"}
    monkeypatch.setattr(parallel, "baseline_environment", lambda: environment)
    monkeypatch.setattr(parallel, "_idle", [])
    with StreamReader(STREAM) as reader:
        assert len(digests(reader)) == 2
    for process in parallel._idle:
        process.stop()
    assert capfd.readouterr().err == ""
