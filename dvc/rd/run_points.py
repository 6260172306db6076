"""Sweeps: measure many points in parallel, here or on a Dask cluster; skip those that are finished."""

import logging
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from importlib import util
from pathlib import Path
from typing import Any

from dvc import cli
from dvc.errors import DvcError
from dvc.files import atomic_output
from dvc.rd.child_processes import ProcessGroup, Stopped
from dvc.rd.measure import measure
from dvc.rd.originals import Source, default_cache, find_source
from dvc.rd.provenance import code_version, input_digest
from dvc.rd.rd_results import POINTS_FOLDER, is_finished, write_result
from dvc.rd.specification import Point, Task
from dvc.versions import codec_digest

Progress = Callable[[int], None]
"""Function that is called with the number of points that have just been finished."""
_LOG = logging.getLogger(__name__)


@dataclass
class SweepSummary:
    """Outcome of a sweep."""

    num_measured: int = 0
    num_skipped: int = 0  # points that were finished before
    failures: list[tuple[str, str]] = field(default_factory=list)  # name and reason of points that failed
    digests: dict[str, str] = field(default_factory=dict)  # digests of the originals, by sequence


def run_points(
    points: Sequence[Point],
    folder: Path,
    cache: Path,
    *,
    jobs: int = 1,
    any_version: bool = False,
    progress: Progress = lambda _: None,
    cluster: str | None = None,
) -> SweepSummary:
    """Measure points."""
    for name in ("encoder", "decoder", "sequences"):
        if util.find_spec(name) is None:
            raise DvcError(f"the package {name!r} is not installed, so that no point can be measured")
    try:
        (folder / POINTS_FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise DvcError(f"cannot write to {folder}: {err.strerror}") from err
    processes = ProcessGroup()
    summary = SweepSummary()
    with ThreadPoolExecutor(jobs) as pool:
        try:
            waiting = []
            for task in _tasks(points, cache, processes, summary, progress, pool):
                if is_finished(folder, task, any_version):
                    summary.num_skipped += 1
                    progress(1)
                else:
                    waiting.append(task)
            if cluster is not None and waiting:
                outcomes = _on_cluster(waiting, folder, cluster)
            else:
                outcomes = _on_threads(waiting, folder, processes, pool)
            for task, failure in outcomes:
                if failure is None:
                    summary.num_measured += 1
                else:
                    summary.failures.append((task.name, failure))
                    _LOG.warning("%s failed: %s", task.name, failure)
                progress(1)
        except BaseException:
            processes.stop()
            pool.shutdown(cancel_futures=True)
            raise
    return summary


def _tasks(
    points: Sequence[Point],
    cache: Path,
    processes: ProcessGroup,
    summary: SweepSummary,
    progress: Progress,
    pool: ThreadPoolExecutor,
) -> list[Task]:
    """Find the original of every point; a missing sequence fails all of its points."""
    code = code_version()
    sources: dict[str, Source | str] = {}
    tasks = []
    for point in points:
        if point.sequence not in sources:
            # In the pool, so that an interrupt reaches this thread while a scene is being rendered.
            source = pool.submit(_find, point.sequence, cache, processes).result()
            sources[point.sequence] = source
            if isinstance(source, str):
                _LOG.warning("no point of %s can be measured: %s", point.sequence, source)
        source = sources[point.sequence]
        if isinstance(source, Source):
            summary.digests[point.sequence] = source.digest
            tasks.append(Task(point, source, code))
        else:
            summary.failures.append((f"{point.sequence}-{point.codec}", source))
            progress(1)
    return tasks


def _find(sequence: str, cache: Path, processes: ProcessGroup) -> Source | str:
    try:
        return find_source(sequence, cache, processes)
    except (DvcError, OSError) as err:
        return cli.one_line(err)


def _on_threads(
    tasks: Sequence[Task], folder: Path, processes: ProcessGroup, pool: ThreadPoolExecutor
) -> Iterator[tuple[Task, str | None]]:
    """Measure points on this machine; yield each when it is finished, with the reason if that failed."""
    futures = {pool.submit(_run_one, task, folder, processes): task for task in tasks}
    for future in as_completed(futures):
        yield futures[future], future.result()


def _run_one(task: Task, folder: Path, processes: ProcessGroup) -> str | None:
    """Measure one point and write its result; return the reason if that failed."""
    try:
        with tempfile.TemporaryDirectory(prefix=".running-", dir=folder) as scratch:
            write_result(folder, task.name, _measure_unchanged(task, Path(scratch), processes))
    except Stopped:
        raise
    except (DvcError, OSError) as err:
        return cli.one_line(err)
    except Exception as err:  # an unexpected error must not end the other points
        return f"{type(err).__name__}: {cli.one_line(err)}"
    return None


def _measure_unchanged(task: Task, scratch: Path, processes: ProcessGroup) -> dict[str, Any]:
    """Measure one point; raise `DvcError` if the code was changed meanwhile."""
    measured = measure(task, scratch, processes)
    if codec_digest() != task.code.digest:
        raise DvcError("the code was changed while the point was measured")
    return measured


@dataclass(frozen=True)
class MeasuredFiles:
    """Result of a worker of a cluster."""

    data: dict[str, Any]  # contents of the result file
    files: dict[str, bytes]  # other files, by path in the folder of the experiment


def _on_cluster(tasks: Sequence[Task], folder: Path, address: str) -> Iterator[tuple[Task, str | None]]:
    """Measure points on the workers of a Dask cluster and write the results here."""
    from dvc.dask_cluster import connected, failure_text

    with connected(address, tasks[0].code.digest) as client:
        from distributed import as_completed as completed

        futures = {
            client.submit(measure_on_worker, task, key=f"{task.name}-{task.identity}", pure=False): task
            for task in tasks
        }
        try:
            for future in completed(futures, loop=client.loop):
                error = future.exception()
                if error is not None:
                    yield futures[future], failure_text(error, "measured this point")
                else:
                    yield futures[future], _store(folder, futures[future], future.result())
        finally:
            client.cancel(list(futures))


def _store(folder: Path, task: Task, measured: MeasuredFiles) -> str | None:
    try:
        for name, content in measured.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            with atomic_output(folder / name) as temporary:
                temporary.write_bytes(content)
        write_result(folder, task.name, measured.data)
    except (DvcError, OSError) as err:
        return cli.one_line(err)
    return None


def measure_on_worker(task: Task) -> MeasuredFiles:
    """Measure a point on this worker of a cluster, in a temporary folder."""
    from dvc.dask_cluster import OTHER_CODE

    if codec_digest() != task.code.digest:
        raise DvcError(OTHER_CODE)
    with tempfile.TemporaryDirectory(prefix="dvc3d-") as name:
        folder = Path(name)
        scratch = folder / ".running"
        scratch.mkdir()
        processes = ProcessGroup()
        data = _measure_unchanged(_with_source(task, processes), scratch, processes)
        files = {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in sorted(folder.rglob("*"))
            if path.is_file() and scratch not in path.parents
        }
    return MeasuredFiles(data, files)


def _with_source(task: Task, processes: ProcessGroup) -> Task:
    """Find the original on this machine: at the same path, or in its own cache of rendered scenes."""
    source = task.source
    if source.path.exists():
        if input_digest(source.path) == source.digest:
            return task
        raise DvcError(f"{source.name}: the worker has another file of this name")
    local = find_source(task.point.sequence, default_cache(), processes)
    if local.digest != source.digest:
        raise DvcError(f"{source.name}: the worker has another sequence of this name")
    return replace(task, source=local)
