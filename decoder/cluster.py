"""Chains of groups of pictures on a Dask cluster: each is a task, and one of a lost worker runs again.

A worker gets the groups of its chain, and nothing else of the stream; it has them decoded by a process of its
own whose libraries are held to the baseline, as on this machine. What a chain comes to is fetched when it is
next in order of display, so that this process holds one at a time.
"""

import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any, cast

from decoder.processes import DecodingProcess, GroupsInFlight
from decoder.session import CHAINS_PER_PROCESS, Reader, StreamGroups, check_stream, stream_tasks
from decoder.tasks import DecodedGroup, GroupTask
from dvc.cluster import OTHER_CODE, failure, require_workers
from dvc.config import CodecConfig
from dvc.errors import BitstreamError, DvcError
from dvc.limits import Limits
from dvc.versions import codec_digest

if TYPE_CHECKING:
    from distributed import Client, Future

PATIENCE_S = 30.0
"""For a chain, before it is asked whether there are workers at all."""
POLL_S = 1.0
"""Time after which a worker notices that nobody wants its chain."""
_LIKE_JOBS = 2
"""A machine of the cluster, and this one, take no more memory for a chain than for two jobs."""


@dataclass
class DecodedChain:
    """What a worker sends back: the groups up to the end of a chain, or to what ended it."""

    groups: list[DecodedGroup] = field(default_factory=list)
    failure: Exception | None = None


def decode_on_cluster(
    config: CodecConfig,
    reader: Reader,
    client: "Client",
    frames: range | None = None,
    limits: Limits | None = None,
) -> Generator[DecodedGroup]:
    """Decode a stream on the workers of a cluster; otherwise as `decoder.session.decode_stream`."""
    limits = limits or Limits()
    check_stream(config, reader, _LIKE_JOBS, frames, limits)
    return _ChainsInFlight(client, stream_tasks(config, reader, frames, limits)).decode()


class _ChainsInFlight:
    """Chains that were given to a cluster: enough that no thread of it waits, and no more."""

    def __init__(self, client: "Client", chains: Iterable[Sequence[GroupTask]]) -> None:
        self._client, self._chains = client, iter(chains)
        self._digest, self._run = codec_digest(), uuid.uuid4().hex[:8]
        self._finished = False
        self._failure: BitstreamError | None = None  # what ended the stream
        self._futures: deque[Future[DecodedChain]] = deque()

    def decode(self) -> Generator[DecodedGroup]:
        """Decode in order of display; what ends the run is raised after all groups before it."""
        try:
            self._submit()
            while self._futures:
                chain = self._result(self._futures[0])
                self._futures.popleft()
                self._submit()
                yield from chain.groups
                if chain.failure is not None:
                    raise chain.failure
            if self._failure is not None:
                raise self._failure
        finally:
            self._client.cancel(list(self._futures))

    def _submit(self) -> None:
        """Give the cluster as many chains as there is room for."""
        max_open = CHAINS_PER_PROCESS * max(sum(self._client.nthreads().values()), 1)
        while not self._finished and len(self._futures) < max_open:
            try:
                chain = next(self._chains, ())
            except BitstreamError as err:
                self._failure, chain = err, ()
            self._finished = not chain
            if chain:
                key = f"decode-{self._run}-{chain[0].number}"
                self._futures.append(self._client.submit(decode_chain, chain, self._digest, key=key))

    def _result(self, future: "Future[DecodedChain]") -> DecodedChain:
        try:
            while not self._has_ended(future):
                require_workers(self._client)
            chain: DecodedChain = future.result()
        except Exception as err:
            raise DvcError(failure(err, "decoded the same groups of pictures")) from err
        return chain

    @staticmethod
    def _has_ended(future: "Future[DecodedChain]") -> bool:
        """Wait for a chain, for a while."""
        with suppress(TimeoutError):
            future.exception(timeout=PATIENCE_S)
            return True
        return False


def decode_chain(chain: Sequence[GroupTask], digest: str) -> DecodedChain:
    """Decode a chain in a process of this worker; depends on nothing but the chain and the code."""
    decoded = DecodedChain()
    try:
        if {_loaded_digest(), codec_digest()} != {digest}:
            raise DvcError(OTHER_CODE)
        for group in GroupsInFlight(_WantedChain(chain), 1).decode():
            decoded.groups.append(group)
    except Exception as err:  # has its place behind the groups before it
        decoded.failure = err
    return decoded


@cache
def _loaded_digest() -> str:
    """Digest the code when this process first decodes, and has loaded just that."""
    return codec_digest()


class _WantedChain(StreamGroups):
    """A chain that is decoded for as long as somebody wants it."""

    def __init__(self, chain: Sequence[GroupTask]) -> None:
        super().__init__([chain], 1)
        self._is_wanted = _is_wanted()

    def wait(self, processes: Sequence[DecodingProcess]) -> list[DecodingProcess]:
        """Wait for the process, or until the chain is cancelled."""
        busy: list[Any] = [process for process in processes if process.num_running]
        while busy:
            if ready := wait(busy, POLL_S):
                return cast(list[DecodingProcess], ready)
            if not self._is_wanted():
                raise DvcError("nobody wants this chain of groups of pictures")
        return []


def _is_wanted() -> Callable[[], bool]:
    """Return what tells whether the task that runs in this thread has been cancelled."""
    from distributed import get_worker

    try:
        worker = get_worker()
    except ValueError:  # no task of a cluster
        return lambda: True
    tasks, key = worker.state.tasks, worker.get_current_task()
    return lambda: key in tasks and tasks[key].state == "executing"
