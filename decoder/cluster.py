"""Groups of pictures on a Dask cluster: each is a task, and that of a lost worker runs again.

A worker gets only its group of the stream; a separate process, with libraries held to the baseline as on
this machine, decodes it. A decoded group is fetched when it is next in order of display, so
that this process holds one at a time.
"""

import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterable
from contextlib import suppress
from functools import cache
from multiprocessing.connection import wait
from typing import TYPE_CHECKING

from decoder.group_tasks import DecodedGroup, GroupTask, Losses
from decoder.processes import decoding_process
from decoder.session import Reader, check_stream, stream_tasks
from dvc.config import CodecConfig
from dvc.dask_cluster import OTHER_CODE, failure_text, require_workers
from dvc.errors import BitstreamError, DvcError
from dvc.limits import Limits
from dvc.versions import codec_digest

if TYPE_CHECKING:
    from distributed import Client, Future

PATIENCE_S = 30.0
"""Wait for a group before the cluster is asked whether it has any workers."""
POLL_S = 1.0
"""Interval at which a worker checks that its group was not cancelled."""
GROUPS_PER_THREAD = 2
"""Number of groups per thread of a worker: one in work, and one waiting."""
_LIKE_JOBS = 2
"""Number of jobs with at least the memory that a group takes on this machine and on the cluster."""


def decode_on_cluster(
    config: CodecConfig,
    reader: Reader,
    client: "Client",
    frames: range | None = None,
    limits: Limits | None = None,
    losses: Losses | None = None,
) -> Generator[DecodedGroup]:
    """Decode a stream on the workers of a cluster; otherwise as `decoder.session.decode_stream`."""
    limits = limits or Limits()
    check_stream(config, reader, _LIKE_JOBS, frames, limits)
    tasks = stream_tasks(config, reader, frames, limits, losses)
    return _GroupsOnCluster(client, tasks, losses).decode()


class _GroupsOnCluster:
    """Groups that were submitted to a cluster: just enough to keep its threads busy."""

    def __init__(self, client: "Client", tasks: Iterable[GroupTask], losses: Losses | None) -> None:
        self._client, self._tasks, self._losses = client, iter(tasks), losses
        self._digest, self._run = codec_digest(), uuid.uuid4().hex[:8]
        self._finished = False
        self._failure: BitstreamError | None = None  # what ended the stream
        self._futures: deque[tuple[Future[DecodedGroup | Exception], GroupTask]] = deque()

    def decode(self) -> Generator[DecodedGroup]:
        """Decode in order of display; what ends the run is raised after all groups before it."""
        try:
            self._submit()
            while self._futures:
                group, (_, task) = self._result(self._futures[0][0]), self._futures.popleft()
                self._submit()
                if isinstance(group, BitstreamError) and self._losses is not None:
                    group = self._losses.rest_of(task, group)
                if isinstance(group, Exception):
                    raise group
                yield group
            if self._failure is not None:
                raise self._failure
        finally:
            self._client.cancel([future for future, _ in self._futures])

    def _submit(self) -> None:
        """Submit as many groups as the cluster has room for."""
        max_open = GROUPS_PER_THREAD * max(sum(self._client.nthreads().values()), 1)
        while not self._finished and len(self._futures) < max_open:
            try:
                task = next(self._tasks, None)
            except BitstreamError as err:
                self._failure, task = err, None
            self._finished = task is None
            if task is not None:
                key = f"decode-{self._run}-{task.number}"
                future = self._client.submit(decode_group, task, self._digest, key=key)
                self._futures.append((future, task))

    def _result(self, future: "Future[DecodedGroup | Exception]") -> DecodedGroup | Exception:
        try:
            while not self._has_ended(future):
                require_workers(self._client)
            group: DecodedGroup | Exception = future.result()
        except Exception as err:
            raise DvcError(failure_text(err, "decoded the same group of pictures")) from err
        return group

    @staticmethod
    def _has_ended(future: "Future[DecodedGroup | Exception]") -> bool:
        """Wait for a group, for a while."""
        with suppress(TimeoutError):
            future.exception(timeout=PATIENCE_S)
            return True
        return False


def decode_group(task: GroupTask, digest: str) -> DecodedGroup | Exception:
    """Decode a group in a process of this worker, or return the exception that ended it."""
    try:
        if {_loaded_digest(), codec_digest()} != {digest}:
            raise DvcError(OTHER_CODE)
        return _decoded(task)
    except Exception as err:  # is raised after the groups before it
        return err


def _decoded(task: GroupTask) -> DecodedGroup | Exception:
    """Decode a group until it is cancelled."""
    if not task.record.wyner_ziv:
        return DecodedGroup.of(task, [])
    is_executing = _is_executing()
    with decoding_process() as process:
        process.submit(task)
        while not wait([process], POLL_S):  # type: ignore[list-item]
            if not is_executing():
                raise DvcError("the task was cancelled")
        _, outcome = process.receive()
    assert isinstance(outcome, DecodedGroup | Exception)  # records answer all requests
    return outcome


@cache
def _loaded_digest() -> str:
    """Digest the code when this process first decodes: it has loaded that code."""
    return codec_digest()


def _is_executing() -> Callable[[], bool]:
    """Return a function that checks whether the task of this thread is still executing."""
    from distributed import get_worker

    try:
        worker = get_worker()
    except ValueError:  # no task of a cluster
        return lambda: True
    tasks, key = worker.state.tasks, worker.get_current_task()
    return lambda: key in tasks and tasks[key].state == "executing"
