"""Processes that decode: what is lent comes back, and what dies is said."""

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import repeat
from pathlib import Path

import pytest

from decoder import processes
from decoder.group_tasks import DecodedGroup, GroupTask
from decoder.processes import DecodingProcess, decoding_process
from decoder.session import GROUPS_PER_PROCESS, GroupsInFlight, StreamGroups, decode_stream, stream_tasks
from dvc.errors import BitstreamError, DvcError
from dvc.stream import Form, GopRecord, StreamReader
from dvc.video import Frame
from tests.clips import moving_texture

STREAM = Path(__file__).parents[1] / "golden" / "streams" / "3d-td-all-punctured.dvc"

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
    return [f"{group.first_index} {group.record.digest}" for group in decode_stream(reader.config, reader)]


@pytest.fixture
def task() -> GroupTask:
    with StreamReader(STREAM) as reader:
        return [*stream_tasks(reader.config, reader)][1]


def outcome_of(process: DecodingProcess, task: GroupTask) -> DecodedGroup:
    process.submit(task)
    number, outcome = process.receive()
    assert number == task.number
    if isinstance(outcome, Exception):
        raise outcome
    assert isinstance(outcome, DecodedGroup)
    return outcome


def test_a_program_that_has_loaded_libraries_decodes_alike() -> None:
    """An unguarded script on libraries of another processor, numpy in use, gets the frames of the stream."""
    environment = os.environ | {"OPENBLAS_CORETYPE": "Sandybridge", "NPY_DISABLE_CPU_FEATURES": "X86_V4"}
    command = [sys.executable, "-c", PROGRAM.format(path=str(STREAM))]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    with StreamReader(STREAM) as reader:
        assert done.stdout.splitlines() == digests(reader)


def test_idle_processes_are_lent_again() -> None:
    with decoding_process() as first:
        pass
    with decoding_process() as again, decoding_process() as other:
        assert again is first
        assert other is not first
        assert other.alive


def test_busy_processes_do_not_come_back() -> None:
    with decoding_process() as process:
        process.num_running = 1
    assert not process.alive


def test_a_killed_process_is_said_and_replaced(task: GroupTask) -> None:
    with decoding_process() as process:
        threading.Timer(0.3, process.kill).start()
        with pytest.raises(DvcError, match="decoding process was killed"):
            list(map(partial(outcome_of, process), repeat(task)))
    assert process not in processes._idle
    with StreamReader(STREAM) as reader:
        assert len(digests(reader)) == 2


def test_a_fault_is_told_with_its_place(task: GroupTask) -> None:
    with decoding_process() as process:
        with pytest.raises(RuntimeError) as caught:
            outcome_of(process, replace(task, record=None))  # type: ignore[arg-type]
        assert "decoder/group.py" in caught.value.__notes__[0]
        assert outcome_of(process, task).record.digest == task.record.digest


def test_processes_end_with_the_program() -> None:
    program = (
        "import os, signal, time\n"
        "from decoder.processes import DecodingProcess, decoding_process\n"
        "with decoding_process() as process:\n"
        "    print(process._process.pid, flush=True)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL
    status = Path("/proc") / done.stdout.strip() / "status"
    deadline = time.monotonic() + 30
    while status.exists() and "zombie" not in status.read_text() and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not status.exists() or "zombie" in status.read_text()


def test_leaving_early_ends_what_is_running() -> None:
    with StreamReader(STREAM) as reader:
        groups = decode_stream(reader.config, reader)
        assert next(groups).first_index == 0
        groups.close()
    assert not any(process.num_running for process in processes._idle)


def test_a_user_that_is_collected_gives_its_process_back(
    task: GroupTask, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was lent to a generator in a cycle of garbage decodes on, for the next one."""
    gc.collect()  # what other tests have left
    monkeypatch.setattr(processes, "_idle", [])

    def user() -> Iterator[list[object]]:
        cycle: list[object] = []
        with decoding_process():
            yield cycle

    abandoned = user()
    next(abandoned).append(abandoned)
    del abandoned
    gc.collect()
    [process] = processes._idle
    try:
        assert outcome_of(process, task).record.digest == task.record.digest
    finally:
        process.stop()


def test_features_that_are_not_there_are_no_news(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What OpenCV says of features that it is to do without, but does not have, reaches no terminal."""
    environment = processes.baseline_environment() | {"OPENCV_CPU_DISABLE": "AVX,NO-SUCH-FEATURE"}
    monkeypatch.setattr(processes, "baseline_environment", lambda: environment)
    monkeypatch.setattr(processes, "_idle", [])
    with StreamReader(STREAM) as reader:
        assert len(digests(reader)) == 2
    for process in processes._idle:
        process.stop()
    assert capfd.readouterr().err == ""


KEY: Frame = moving_texture(1, 16, 16)[0]


def task_of(number: int, payloads: tuple[bytes, ...] = ()) -> GroupTask:
    """Return a group that is a key frame, or has others before it."""
    record = GopRecord(1 + len(payloads), b"x", wyner_ziv=payloads)
    return GroupTask(b"", number, number, None, KEY, record, Form.BUFFERED)


def damaged(count: int, seen: list[int]) -> Iterator[GroupTask]:
    """Give some groups, and then what is wrong with the stream; note what was given."""
    for number in range(count):
        seen.append(number)
        yield task_of(number)
    raise BitstreamError("broken")


def test_nothing_is_decoded_where_there_is_nothing() -> None:
    assert list(GroupsInFlight(StreamGroups([], 1), 1).decode()) == []


@pytest.mark.parametrize("jobs", [1, 3])
def test_damage_comes_after_the_groups_before_it(jobs: int) -> None:
    seen: list[int] = []
    groups = GroupsInFlight(StreamGroups(damaged(20, seen), jobs), jobs).decode()
    assert next(groups).first_index == 0
    assert seen == list(range(GROUPS_PER_PROCESS * jobs))
    found = []
    with pytest.raises(BitstreamError, match="broken"):
        found.extend(group.first_index for group in groups)
    assert found == list(range(1, 20))


class Interrupted(StreamGroups):
    def wait(self, processes: Sequence[DecodingProcess]) -> list[DecodingProcess]:
        raise KeyboardInterrupt


def test_what_is_decoded_comes_before_an_interrupt() -> None:
    tasks = [task_of(0), task_of(1), task_of(2, (b"x",))]
    groups = GroupsInFlight(Interrupted(tasks, 2), 2).decode()
    assert [next(groups).first_index, next(groups).first_index] == [0, 1]
    with pytest.raises(KeyboardInterrupt):
        next(groups)


class Immediate:
    """A process that has decoded a group as soon as it gets it."""

    began_s = 0.0

    def __init__(self, most_running: list[int]) -> None:
        self._most_running = most_running
        self.told: list[DecodedGroup] = []

    @property
    def num_running(self) -> int:
        return len(self.told)

    def submit(self, task: GroupTask) -> None:
        self.told.append(DecodedGroup(task.first_index, (), task.key, task.record))
        self._most_running.append(self.num_running)

    def receive(self) -> tuple[int, DecodedGroup]:
        group = self.told.pop(0)
        return group.first_index, group


class Told(StreamGroups):
    def wait(self, processes: Sequence[DecodingProcess]) -> list[DecodingProcess]:
        """Name those that have something to tell, the last of them first."""
        return [process for process in reversed(processes) if process.num_running]


@pytest.mark.parametrize("jobs", [1, 2, 4])
def test_groups_come_in_order_and_wait_for_an_idle_process(
    monkeypatch: pytest.MonkeyPatch, jobs: int
) -> None:
    lent: list[Immediate] = []
    most_running: list[int] = []

    def lend() -> nullcontext[Immediate]:
        lent.append(Immediate(most_running))
        return nullcontext(lent[-1])

    monkeypatch.setattr("decoder.session.decoding_process", lend)
    tasks = [task_of(number, (b"x",) * (number % 3 > 0)) for number in range(20)]
    found = [group.first_index for group in GroupsInFlight(Told(tasks, jobs), jobs).decode()]
    assert found == list(range(20))
    assert set(most_running) == {1}
    assert len(lent) == jobs
