"""Groups of pictures on a Dask cluster: each is a task, and that of a lost worker runs again.

A worker gets only its group of the stream; a separate process, with libraries held to the baseline as on
this machine, decodes it. A decoded group is fetched when it is next in order of display, so
that this process holds one at a time.
"""

import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from functools import cache
from multiprocessing.connection import wait
from typing import TYPE_CHECKING

from decoder.group_tasks import DecodedGroup, GroupTask, Losses, Reader
from decoder.processes import decoding_process
from decoder.session import check_stream, stream_tasks
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
    return _decoded_in_order(client, stream_tasks(config, reader, frames, limits, losses), losses)


def _decoded_in_order(
    client: "Client", tasks: Iterator[GroupTask], losses: Losses | None
) -> Generator[DecodedGroup]:
    """Decode groups, no more than keep the threads of a cluster busy; raise errors after all before them."""
    digest, run = codec_digest(), uuid.uuid4().hex[:8]
    is_finished = False
    failure: BitstreamError | None = None  # ends the stream
    futures: deque[tuple[Future[DecodedGroup | Exception], GroupTask]] = deque()

    def _submit() -> None:
        nonlocal is_finished, failure
        max_open = GROUPS_PER_THREAD * max(sum(client.nthreads().values()), 1)
        while not is_finished and len(futures) < max_open:
            try:
                task = next(tasks, None)
            except BitstreamError as err:
                failure, task = err, None
            is_finished = task is None
            if task is not None:
                key = f"decode-{run}-{task.number}"
                futures.append((client.submit(decode_group, task, digest, key=key), task))

    try:
        _submit()
        while futures:
            group, (_, task) = _result(client, futures[0][0]), futures.popleft()
            _submit()
            if isinstance(group, BitstreamError) and losses is not None:
                group = losses.rest_of(task, group)
            if isinstance(group, Exception):
                raise group
            yield group
        if failure is not None:
            raise failure
    finally:
        client.cancel([future for future, _ in futures])


def _result(client: "Client", future: "Future[DecodedGroup | Exception]") -> DecodedGroup | Exception:
    """Wait for a group; now and then check that the cluster has workers."""
    try:
        while True:
            with suppress(TimeoutError):
                future.exception(timeout=PATIENCE_S)
                break
            require_workers(client)
        group: DecodedGroup | Exception = future.result()
    except Exception as err:
        raise DvcError(failure_text(err, "decoded the same group of pictures")) from err
    return group


def decode_group(task: GroupTask, digest: str) -> DecodedGroup | Exception:
    """Decode a group in a process of this worker, or return the exception that ended it."""
    try:
        if {_loaded_digest(), codec_digest()} != {digest}:
            raise DvcError(OTHER_CODE)
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
    except Exception as err:  # is raised after the groups before it
        return err


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
