"""Groups of a live encoder in a decoding process: the same for any order of answers."""

import multiprocessing
import random
import subprocess
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from decoder import processes
from decoder.group import GroupCoroutine, GroupDecoder, LevelBegins, RecordedGroup
from decoder.group_tasks import Answered, DecodedGroup, GroupTask
from decoder.processes import DecodingProcess, Outcome, decoding_process
from dvc.config import CascadeConfig, CodecConfig, Qp, VideoConfig, codec_config
from dvc.environment import baseline_environment
from dvc.errors import BitstreamError
from dvc.slepian_wolf import Answer, ParityRequest, Round, drive, plane_coder
from dvc.stream import GopRecord
from dvc.video import Frame
from dvc.wynerziv.encoder_buffer import EncoderBuffer
from dvc.wynerziv.payloads import EncodedFrame
from dvc.wynerziv.quantizer import FrameLayout
from tests.clips import moving_texture
from tests.streams import config_of, encoded, tasks_of
from tests.waiting import PATIENCE_S


def answering(task: GroupTask, config: CodecConfig) -> Answer:
    """Return what answers for all frames of a group, as a live encoder does."""
    layout = FrameLayout.of(config)
    buffer = EncoderBuffer(layout, plane_coder(config), len(task.record.wyner_ziv))
    for slot, payload in enumerate(task.record.wyner_ziv):
        buffer.enter(slot, EncodedFrame.read(layout, payload))
    return partial(buffer.answer_round, first_frame=task.first_index)


class Answering:
    """A process that decodes groups as those of a live encoder, and the records that answer in its place."""

    def __init__(self, process: DecodingProcess, config: CodecConfig, tasks: list[GroupTask]) -> None:
        self.process = process
        self.groups: dict[int, DecodedGroup] = {}
        self._answers = {task.number: answering(task, config) for task in tasks}
        self._waiting: list[tuple[int, Round]] = []
        process.submit(*(replace(task, form=None) for task in tasks))

    def receive(self) -> tuple[int, Outcome]:
        number, outcome = self.process.receive()
        if number not in self._answers:
            return number, outcome
        if isinstance(outcome, Exception):
            raise outcome
        if isinstance(outcome, DecodedGroup):
            self.groups[number] = outcome
        elif outcome:
            self._waiting.append((number, outcome))
        return number, outcome

    def answer_some(self, shuffled: random.Random) -> bool:
        """Answer some of what waits, in any order; tell whether there was anything."""
        shuffled.shuffle(self._waiting)
        count = shuffled.randint(min(1, len(self._waiting)), len(self._waiting))
        chosen, self._waiting = self._waiting[:count], self._waiting[count:]
        answers = [Answered(number, tuple(self._answers[number](requests))) for number, requests in chosen]
        self.process.submit(*answers)
        return count > 0


Groups = tuple[CodecConfig, list[GroupTask]]


@pytest.fixture(scope="module")
def config_and_tasks() -> Groups:
    video, gop = VideoConfig(32, 24, 25, 1, luma_only=True), {"length": 8, "references": "hierarchical"}
    config = codec_config(video, "2d", Qp(32), gop=gop, key={"qp": 36}, coder=CascadeConfig(20))
    stream = encoded(config, [Frame(frame.luma) for frame in moving_texture(30, 24, 32)])
    return config_of(stream), [task for task in tasks_of(stream) if task.before is not None]


@pytest.mark.parametrize("seed", [1, 3])
def test_any_order_of_answers_gives_the_same(config_and_tasks: Groups, seed: int) -> None:
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


def test_what_most_levels_depend_on_comes_first(config_and_tasks: Groups) -> None:
    """The middle frame comes before all others; at the same level the first group comes first."""
    (config, (task, *_)), levels = config_and_tasks, list[LevelBegins]()
    record = RecordedGroup(task, config)

    def answer(asked: Round | LevelBegins) -> Sequence[np.ndarray]:
        if isinstance(asked, LevelBegins):
            levels.append(asked)
        else:
            assert {request.frame for request in asked} == {levels[-1].frames[0]}
        return record.answer(asked)

    drive(GroupDecoder(config).steps(task), answer)
    first, number, frame_px = task.first_index, task.number, 32 * 24
    assert levels == [
        ((-3, number), (first + 3,), frame_px),
        ((-2, number), (first + 1, first + 5), 2 * frame_px),
        ((-1, number), (first, first + 2, first + 4, first + 6), 4 * frame_px),
    ]


def test_wrong_answers_end_the_group_alone(config_and_tasks: Groups) -> None:
    (config, (task, *others)) = config_and_tasks
    with decoding_process() as process:
        live = Answering(process, config, others)
        process.submit(replace(task, form=None))
        number, outcome = live.receive()
        while number != task.number or outcome == ():
            number, outcome = live.receive()
        process.submit(Answered(task.number, (np.zeros(0, np.uint8),)))
        while not (number == task.number and isinstance(outcome, Exception)):
            number, outcome = live.receive()
        assert "bits as uint8" in str(outcome)
        shuffled = random.Random(2)
        while len(live.groups) < len(others):
            if process.num_pending or not live.answer_some(shuffled):
                live.receive()
    with decoding_process() as other:
        assert other is process


def test_a_process_that_nobody_wants_ends_without_a_word(config_and_tasks: Groups) -> None:
    ours, theirs = multiprocessing.Pipe()
    command = [sys.executable, "-P", "-m", "decoder.processes", str(theirs.fileno())]
    process = subprocess.Popen(
        command, pass_fds=[theirs.fileno()], env=baseline_environment(), stderr=subprocess.PIPE
    )
    theirs.close()
    ours.send(tuple(replace(task, form=None) for task in config_and_tasks[1]))
    ours.recv()
    ours.close()
    _, said = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, said) == (0, b"")


Level = tuple[int, int]
"""How many levels follow, negative, and pixels."""


class Scripted:
    """A decoder of groups that have levels as they are told, of which each asks once."""

    def __init__(self, levels: Mapping[int, Sequence[Level | Exception]]) -> None:
        self._levels = levels

    def steps(self, task: GroupTask) -> GroupCoroutine:
        for level in self._levels[task.number]:
            if isinstance(level, Exception):
                raise level
            yield LevelBegins((level[0], task.number), (task.first_index,), level[1])
            (bits,) = yield (ParityRequest(task.first_index, 0, "crc", 0, 0, 8),)
            assert bits.size == 8
        return DecodedGroup.of(replace(task, record=GopRecord(1, b"")), [])


class Scene:
    """A worker that decodes scripted groups, by number, and what it does."""

    def __init__(self, levels: Mapping[int, Sequence[Level | Exception]]) -> None:
        self.coming: deque[tuple[GroupTask | Answered, ...]] = deque()
        self.sent: list[tuple[int, object]] = []
        self.counts = 0, 0  # open tasks, and messages that were taken
        connection = SimpleNamespace(
            poll=lambda: bool(self.coming), recv=self.coming.popleft, send=self._send
        )
        self.worker = processes._Worker(cast(Any, connection))
        self.decoders: list[Scripted] = []
        self.given_back: list[Scripted] = []
        self._levels = levels
        self.worker._acquire = self._acquire  # type: ignore[assignment]
        self.worker._release = self._release  # type: ignore[assignment]

    def _send(self, message: tuple[int, object, int, int]) -> None:
        self.sent.append(message[:2])
        self.counts = message[2:]

    def _acquire(self, config: bytes) -> Scripted:
        if config:
            raise KeyError(config)
        self.decoders.append(Scripted(self._levels))
        return self.decoders[-1]

    def _release(self, decoder: Scripted, config: bytes) -> None:
        self.given_back.append(decoder)

    def begin(self, *numbers: int, config: bytes = b"") -> list[tuple[int, object]]:
        """Hand over groups, and return what the worker sends until it waits."""
        frame, record = Frame(np.zeros((8, 8), np.uint8)), GopRecord(2, b"", wyner_ziv=(b"",))
        return self._settled(
            *(GroupTask(config, number, 10 * number, None, frame, record, None) for number in numbers)
        )

    def answer(self, *numbers: int) -> list[tuple[int, object]]:
        """Answer groups, and return what the worker sends until it waits, but where it asks for nothing."""
        return self._settled(*(Answered(number, (np.zeros(8, np.uint8),)) for number in numbers))

    def _settled(self, *messages: GroupTask | Answered) -> list[tuple[int, object]]:
        known = len(self.sent)
        self.coming.append(messages)
        self.worker.receive(wait=True)
        while not self.worker.is_idle:
            self.worker.step()
        assert self.counts[0] == 0
        return [sent for sent in self.sent[known:] if sent[1] != ()]

    def asked(self, found: Sequence[tuple[int, object]]) -> list[int]:
        """Return which groups ask for something, in order."""
        return [number for number, outcome in found if isinstance(outcome, tuple)]


def ended(found: Sequence[tuple[int, object]]) -> list[int]:
    return [number for number, outcome in found if isinstance(outcome, DecodedGroup)]


def test_groups_of_a_lower_rank_go_first() -> None:
    """Those with the most levels to come, whoever is answered first; then the first in display order."""
    scene = Scene({1: [(-2, 1), (-1, 1)], 2: [(-3, 1), (-2, 1), (-1, 1)], 3: [(-3, 1), (-2, 1), (-1, 1)]})
    assert sorted(scene.asked(scene.begin(1, 2, 3))) == [1, 2, 3]
    assert scene.counts == (0, 3)
    assert scene.asked(scene.answer(1, 3, 2)) == [2, 3, 1]
    assert scene.asked(scene.answer(3)) == [3]
    found = scene.answer(1, 2, 3)
    assert scene.asked(found) == [2]
    assert sorted(ended(found)) == [1, 3]
    assert ended(scene.answer(2)) == [2]
    assert scene.counts == (0, 11)
    assert len(scene.given_back) == 3
    assert set(scene.given_back) == set(scene.decoders)


def test_levels_wait_for_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """As long as others have it; the lowest rank that waits is the next, and nobody overtakes it."""
    monkeypatch.setattr(processes, "MAX_ACTIVE_PX", 10)
    scene = Scene({1: [(-2, 6), (-1, 4)], 2: [(-2, 6)], 3: [(-1, 2)], 4: [(-3, 30)], 5: [(-4, 3)]})
    assert scene.asked(scene.begin(1)) == [1]
    assert scene.asked(scene.begin(2, 3)) == []
    assert scene.asked(scene.answer(1)) == [2, 1]
    assert scene.asked(scene.begin(4, 5)) == []
    assert scene.counts == (0, 6)
    found = scene.answer(1)
    assert (ended(found), scene.asked(found)) == ([1], [5])
    found = scene.answer(5)
    assert (ended(found), scene.asked(found)) == ([5], [])
    found = scene.answer(2)
    assert (ended(found), scene.asked(found)) == ([2], [4])
    found = scene.answer(4)
    assert (ended(found), scene.asked(found)) == ([4], [3])
    assert ended(scene.answer(3)) == [3]
    assert scene.worker._used_px == 0


def test_a_group_that_fails_holds_up_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "MAX_ACTIVE_PX", 10)
    scene = Scene({1: [(-2, 9), BitstreamError("damage")], 2: [(-1, 8)], 3: [ValueError("of a method")]})
    assert scene.asked(scene.begin(1, 2)) == [1]
    ((number, other),) = scene.begin(3)
    assert (number, type(other), str(other)) == (3, RuntimeError, "ValueError('of a method')")
    assert "in the decoding process" in other.__notes__[0]  # type: ignore[attr-defined]
    found = scene.answer(1)
    assert dict(found).keys() == {1, 2}
    error = dict(found)[1]
    assert isinstance(error, BitstreamError)
    assert str(error) == "group of pictures 1: damage"
    assert scene.asked(found) == [2]
    ((number, refused),) = scene.begin(4, config=b"no configuration")
    assert (number, type(refused)) == (4, RuntimeError)
    assert ended(scene.answer(2)) == [2]
    assert scene.given_back == [scene.decoders[1]]
