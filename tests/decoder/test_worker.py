"""Groups of a live encoder in a decoding process: the same for any order of answers."""

import io
import random
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import Pipe
from queue import SimpleQueue

import numpy as np
import pytest

from decoder.group import GroupDecoder, Rank, RecordedGroup
from decoder.processes import DecodingProcess, decoding_process
from decoder.session import stream_tasks
from decoder.tasks import Answered, DecodedFrame, DecodedGroup, GroupTask
from decoder.team import Team
from decoder.worker import _Encoder
from decoder.wyner_ziv import FrameCoroutine
from dvc.config import CascadeConfig, CodecConfig, Qp, VideoConfig, codec_config
from dvc.environment import baseline_environment
from dvc.errors import BitstreamError
from dvc.slepian_wolf import ParityRequest
from dvc.stream import StreamReader
from dvc.video import Frame
from encoder.session import EncoderSession
from tests.clips import moving_texture
from tests.waiting import PATIENCE_S


class Answering:
    """A process that decodes groups as those of a live encoder, and the records that answer in its place."""

    def __init__(self, process: DecodingProcess, config: CodecConfig, tasks: list[GroupTask]) -> None:
        self.process = process
        self.groups: dict[int, DecodedGroup] = {}
        self._records = {task.number: RecordedGroup(task, config) for task in tasks}
        self._waiting: list[tuple[int, ParityRequest]] = []
        process.submit(*(replace(task, form=None) for task in tasks))

    def receive(self) -> None:
        """Take what comes next."""
        number, outcome = self.process.receive()
        if isinstance(outcome, Exception):
            raise outcome
        if isinstance(outcome, DecodedGroup):
            self.groups[number] = outcome
        elif isinstance(outcome, tuple):
            self._waiting += [(number, outcome)] if outcome else []

    def answer_some(self, shuffled: random.Random) -> bool:
        """Answer some of what waits, in any order; tell whether there was anything."""
        shuffled.shuffle(self._waiting)
        count = shuffled.randint(min(1, len(self._waiting)), len(self._waiting))
        chosen, self._waiting = self._waiting[:count], self._waiting[count:]
        answers = [
            Answered(requests[0].frame, tuple(self._records[number].answer(requests)))
            for number, requests in chosen
        ]
        self.process.submit(*answers)
        return count > 0


@pytest.fixture(scope="module")
def config_and_tasks() -> tuple[CodecConfig, list[GroupTask]]:
    """Return groups that begin with a key frame."""
    video, gop = VideoConfig(32, 24, 25, 1, luma_only=True), {"length": 8, "references": "hierarchical"}
    config = codec_config(video, "2d", Qp(32), gop=gop, key={"qp": 36}, coder=CascadeConfig(20))
    file = io.BytesIO()
    EncoderSession(config).write(
        [Frame(frame.luma) for frame in moving_texture(30, 24, 32)], file, lambda _: None
    )
    with StreamReader(io.BytesIO(file.getvalue())) as reader:
        tasks = list(stream_tasks(reader.config, reader))
    return reader.config, [task for task in tasks if task.before is not None]


@pytest.mark.parametrize("seed", [1, 3])
def test_any_order_of_answers_gives_the_same(
    config_and_tasks: tuple[CodecConfig, list[GroupTask]], seed: int
) -> None:
    """Groups are those of a stream, and no step of decoding is left over."""
    (config, tasks), shuffled = config_and_tasks, random.Random(seed)
    with decoding_process() as process:
        live = Answering(process, config, tasks)
        while len(live.groups) < len(tasks):
            answers = process.num_pending == 0 or shuffled.random() < 0.5
            if not (answers and live.answer_some(shuffled)):
                live.receive()
        assert (process.num_running, process.num_pending) == (0, 0)
    for task in tasks:
        wanted = GroupDecoder(config).decode(task)
        assert live.groups[task.number].record == wanted.record


class NotedLevels(RecordedGroup):
    """A record that notes which levels begin."""

    def __init__(self, task: GroupTask, config: CodecConfig) -> None:
        super().__init__(task, config)
        self.levels: list[tuple[Rank, int]] = []

    def decode_level(self, rank: Rank, frames: Sequence[FrameCoroutine]) -> list[DecodedFrame]:
        """Note the rank of a level, and how many frames it has."""
        self.levels.append((rank, len(frames)))
        return super().decode_level(rank, frames)


def test_what_most_levels_depend_on_comes_first(
    config_and_tasks: tuple[CodecConfig, list[GroupTask]],
) -> None:
    """The middle frame comes before all others; at the same level the first group comes first."""
    config, tasks = config_and_tasks
    encoder = NotedLevels(tasks[0], config)
    GroupDecoder(config).decode(tasks[0], encoder)
    number = tasks[0].number
    assert encoder.levels == [((-3, number), 1), ((-2, number), 2), ((-1, number), 4)]


def test_wrong_answers_end_the_group(config_and_tasks: tuple[CodecConfig, list[GroupTask]]) -> None:
    """Bits that are too few for what a frame asked end its group, and the process serves nobody else."""
    _, tasks = config_and_tasks
    with decoding_process() as process:
        process.submit(replace(tasks[0], form=None))
        outcome: object = ()
        while outcome == ():
            number, outcome = process.receive()
        assert isinstance(outcome, tuple)
        process.submit(Answered(outcome[0].frame, (np.zeros(0, np.uint8),)))
        while isinstance(outcome, tuple):
            number, outcome = process.receive()
    assert number == tasks[0].number
    assert isinstance(outcome, Exception)
    with decoding_process() as other:
        assert other is not process


def test_a_group_without_a_frame_before_it_is_refused(
    config_and_tasks: tuple[CodecConfig, list[GroupTask]],
) -> None:
    """The error has the number of the group."""
    _, tasks = config_and_tasks
    with decoding_process() as process:
        process.submit(replace(tasks[1], form=None, before=None))
        outcome: object = ()
        while outcome == ():
            _, outcome = process.receive()
    assert isinstance(outcome, BitstreamError)
    assert f"group of pictures {tasks[1].number}: Wyner-Ziv frames without a frame" in str(outcome)


def test_a_process_that_nobody_wants_ends_without_a_word(
    config_and_tasks: tuple[CodecConfig, list[GroupTask]],
) -> None:
    """Whatever its threads are at when the other end is gone."""
    ours, theirs = Pipe()
    command = [sys.executable, "-P", "-m", "decoder.worker", str(theirs.fileno())]
    process = subprocess.Popen(
        command,
        pass_fds=[theirs.fileno()],
        env=baseline_environment(),
        stderr=subprocess.PIPE,
    )
    theirs.close()
    ours.send(tuple(replace(task, form=None) for task in config_and_tasks[1]))
    ours.recv()
    ours.close()
    _, said = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, said) == (0, b"")


def test_a_frame_that_fails_does_not_hold_up_others() -> None:
    """Its step is over for the other side, which else would hold the requests of the frames beside it."""

    class Parent:
        def __init__(self) -> None:
            self.answers: dict[int, SimpleQueue[Sequence[np.ndarray]]] = {}
            self.asked: SimpleQueue[object] = SimpleQueue()
            self.steps = 0

        def send(self, number: int, outcome: object, steps: int = 0) -> None:
            assert number == 0
            self.steps += steps
            if outcome:
                self.asked.put(outcome)

    def asking() -> FrameCoroutine:
        yield (ParityRequest(5, 0, "crc", 0, 0, 8),)
        raise AssertionError("no such frame is decoded")

    def failing() -> FrameCoroutine:
        raise BitstreamError("damage")
        yield ()

    parent, video = Parent(), VideoConfig(32, 24, 25, 1)
    worker = _Encoder(0, video, parent, Team())  # type: ignore[arg-type]
    with ThreadPoolExecutor() as pool:
        level = pool.submit(worker.decode_level, (0, 0), [asking(), failing()])
        parent.asked.get(timeout=PATIENCE_S)
        deadline = time.monotonic() + PATIENCE_S
        while parent.steps and time.monotonic() < deadline:
            time.sleep(0.01)
        assert parent.steps == 0
        parent.answers[5].put([np.zeros(8, np.uint8)])
        with pytest.raises(AssertionError, match="no such frame"):
            level.result(PATIENCE_S)
