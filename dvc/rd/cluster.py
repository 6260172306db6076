"""Points on a Dask cluster: the workers measure, this process writes; a point of a lost worker runs again."""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from dvc.cluster import OTHER_CODE, connected, failure
from dvc.errors import DvcError
from dvc.rd.measure import measure
from dvc.rd.points import Task
from dvc.rd.processes import ProcessGroup
from dvc.rd.provenance import input_digest
from dvc.rd.sources import default_cache, find_source
from dvc.versions import codec_digest

_SCRATCH = ".running"


@dataclass(frozen=True)
class Measured:
    """What a worker sends back."""

    data: dict[str, Any]  # contents of the result file
    # other files, by their place in the folder of the experiment
    files: dict[str, bytes] = field(default_factory=dict)


def measure_on_cluster(tasks: Sequence[Task], address: str) -> Iterator[tuple[Task, Measured | str]]:
    """Measure points on the workers of a Dask cluster."""
    with connected(address, tasks[0].code.digest) as client:
        from distributed import as_completed

        futures = {
            client.submit(_measure_here, task, key=f"{task.name}-{task.identity}", pure=False): task
            for task in tasks
        }
        try:
            for future in as_completed(futures, loop=client.loop):
                yield futures[future], _outcome(future)
        finally:
            client.cancel(list(futures))


def _outcome(future: Any) -> Measured | str:
    error = future.exception()
    if error is not None:
        return failure(error, "measured this point")
    measured: Measured = future.result()
    return measured


def _measure_here(task: Task) -> Measured:
    """Measure a point on this worker, in folders of its own; depends on nothing but the point."""
    if codec_digest() != task.code.digest:
        raise DvcError(OTHER_CODE)
    with tempfile.TemporaryDirectory(prefix="dvc3d-") as name:
        folder = Path(name)
        scratch = folder / _SCRATCH
        scratch.mkdir()
        processes = ProcessGroup()
        data = measure(_with_source(task, processes), scratch, processes)
        if codec_digest() != task.code.digest:
            raise DvcError("the code was changed while the point was measured")
        files = {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in sorted(folder.rglob("*"))
            if path.is_file() and scratch not in path.parents
        }
    return Measured(data, files)


def _with_source(task: Task, processes: ProcessGroup) -> Task:
    """Find the original on this machine: at the same place, or in its own cache of rendered scenes."""
    source = task.source
    if source.path.exists():
        if input_digest(source.path) == source.digest:
            return task
        raise DvcError(f"{source.name}: the file that the worker has is another one")
    found = find_source(task.point.sequence, default_cache(), processes)
    if found.digest != source.digest:
        raise DvcError(f"{source.name}: the sequence that the worker has is another one")
    return replace(task, source=found)
