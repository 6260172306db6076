"""Sweeps: measure many points, several at a time; skip what is done; go on when one fails."""

import logging
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from importlib import util
from pathlib import Path
from typing import TYPE_CHECKING

from dvc import cli
from dvc.errors import DvcError
from dvc.files import atomic_output
from dvc.rd.measure import measure
from dvc.rd.points import Point, Task
from dvc.rd.processes import ProcessGroup, Stopped
from dvc.rd.provenance import code_version
from dvc.rd.results import POINTS_FOLDER, finished, write_result
from dvc.rd.sources import Source, find_source
from dvc.versions import codec_digest

if TYPE_CHECKING:
    from dvc.rd.cluster import Measured

Progress = Callable[[int], None]
"""Called with the number of points that have just been finished."""
_LOG = logging.getLogger(__name__)


@dataclass
class SweepSummary:
    """What became of the points of a sweep."""

    num_measured: int = 0  # points measured now, and found finished
    num_skipped: int = 0
    failures: list[tuple[str, str]] = field(default_factory=list)  # name of each point that failed, and why
    digests: dict[str, str] = field(default_factory=dict)  # of the originals that were found, by sequence


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
    _check_installed()
    _make_folder(folder)
    processes = ProcessGroup()
    summary = SweepSummary()
    with ThreadPoolExecutor(jobs) as pool:
        try:
            tasks = _tasks(points, cache, processes, summary, progress, pool)
            waiting = []
            for task in tasks:
                if finished(folder, task, any_version):
                    summary.num_skipped += 1
                    progress(1)
                else:
                    waiting.append(task)
            if cluster is not None and waiting:
                outcomes = _on_cluster(waiting, folder, cluster)
            else:
                outcomes = _on_threads(waiting, folder, processes, pool)
            for task, failure in outcomes:
                _note(summary, task.name, failure)
                progress(1)
        except BaseException:
            processes.stop()
            pool.shutdown(cancel_futures=True)
            raise
    return summary


def _check_installed() -> None:
    for name in ("encoder", "decoder", "sequences"):
        if util.find_spec(name) is None:
            raise DvcError(f"the package {name!r} is not installed, so that no point can be measured")


def _make_folder(folder: Path) -> None:
    try:
        (folder / POINTS_FOLDER).mkdir(parents=True, exist_ok=True)
    except OSError as err:
        raise DvcError(f"cannot write to {folder}: {err.strerror}") from err


def _tasks(
    points: Sequence[Point],
    cache: Path,
    processes: ProcessGroup,
    summary: SweepSummary,
    progress: Progress,
    pool: ThreadPoolExecutor,
) -> list[Task]:
    """Find the original of every point; a sequence that is not there fails all of its points."""
    code = code_version()
    sources: dict[str, Source | str] = {}
    tasks = []
    for point in points:
        if point.sequence not in sources:
            # In the pool, so that an interrupt reaches this thread while a scene is being rendered.
            found = pool.submit(_find, point.sequence, cache, processes).result()
            sources[point.sequence] = found
            if isinstance(found, str):
                _LOG.warning("no point of %s can be measured: %s", point.sequence, found)
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


def _on_cluster(tasks: Sequence[Task], folder: Path, address: str) -> Iterator[tuple[Task, str | None]]:
    """Measure points on a cluster and write what comes back."""
    from dvc.rd.cluster import measure_on_cluster

    for task, outcome in measure_on_cluster(tasks, address):
        yield task, outcome if isinstance(outcome, str) else _store(folder, task, outcome)


def _store(folder: Path, task: Task, measured: "Measured") -> str | None:
    try:
        for name, content in measured.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            with atomic_output(folder / name) as temporary:
                temporary.write_bytes(content)
        write_result(folder, task.name, measured.data)
    except (DvcError, OSError) as err:
        return cli.one_line(err)
    return None


def _run_one(task: Task, folder: Path, processes: ProcessGroup) -> str | None:
    """Measure one point and write its result; return why that failed."""
    try:
        with tempfile.TemporaryDirectory(prefix=".running-", dir=folder) as scratch:
            measured = measure(task, Path(scratch), processes)
            if codec_digest() != task.code.digest:
                raise DvcError("the code was changed while the point was measured")
            write_result(folder, task.name, measured)
    except Stopped:
        raise
    except (DvcError, OSError) as err:
        return cli.one_line(err)
    except Exception as err:  # whatever it is, the other points go on
        return f"{type(err).__name__}: {cli.one_line(err)}"
    return None


def _note(summary: SweepSummary, name: str, failure: str | None) -> None:
    if failure is None:
        summary.num_measured += 1
    else:
        summary.failures.append((name, failure))
        _LOG.warning("%s failed: %s", name, failure)
