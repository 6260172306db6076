"""Sweeps: measure many points, several at a time; skip what is done; go on when one fails."""

import logging
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path

from dvc import cli
from dvc.errors import DvcError
from dvc.rd.measure import measure
from dvc.rd.points import Point
from dvc.rd.processes import ProcessGroup
from dvc.rd.provenance import code_version
from dvc.rd.results import POINTS_FOLDER, Task, finished, write_result
from dvc.rd.sources import Source, find_source

Progress = Callable[[int], None]
"""Called with the number of points that have just been finished."""
_LOG = logging.getLogger(__name__)


@dataclass
class SweepSummary:
    """What became of the points of a sweep.

    Attributes
    ----------
    num_measured, num_skipped : int
        Points measured now, and found finished.
    failures : list of (str, str)
        Name of each point that failed, and why.
    """

    num_measured: int = 0
    num_skipped: int = 0
    failures: list[tuple[str, str]] = field(default_factory=list)


def run_points(
    points: Sequence[Point],
    folder: Path,
    cache: Path,
    *,
    jobs: int = 1,
    any_version: bool = False,
    progress: Progress = lambda _: None,
) -> SweepSummary:
    """Measure points.

    Parameters
    ----------
    points : sequence of Point
        What to measure.
    folder : Path
        Of the experiment; made if needed. Results go to its folder ``points``.
    cache : Path
        Folder of rendered scenes.
    jobs : int, optional
        Points that are measured at the same time.
    any_version : bool, optional
        Keep results of other versions of the code.
    progress : callable, optional
        Called with the number of points just finished, whether well or not.

    Returns
    -------
    SweepSummary
        How it went; failures are logged as well.

    Raises
    ------
    DvcError
        If the folder cannot be made.
    """
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
            futures = {pool.submit(_run_one, task, folder, processes): task for task in waiting}
            for future in as_completed(futures):
                _note(summary, futures[future].name, future.result())
                progress(1)
        except BaseException:
            processes.stop()
            pool.shutdown(cancel_futures=True)
            raise
    return summary


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
            sources[point.sequence] = pool.submit(_find, point.sequence, cache, processes).result()
        source = sources[point.sequence]
        if isinstance(source, Source):
            tasks.append(Task(point, source, code))
        else:
            _note(summary, f"{point.sequence}-{point.codec}", source)
            progress(1)
    return tasks


def _find(sequence: str, cache: Path, processes: ProcessGroup) -> Source | str:
    try:
        return find_source(sequence, cache, processes)
    except (DvcError, OSError) as err:
        return cli.one_line(err)


def _run_one(task: Task, folder: Path, processes: ProcessGroup) -> str | None:
    """Measure one point and write its result; return why that failed."""
    try:
        with tempfile.TemporaryDirectory(prefix=".running-", dir=folder) as scratch:
            write_result(folder, task.name, measure(task, Path(scratch), processes))
    except (DvcError, OSError) as err:
        return cli.one_line(err)
    return None


def _note(summary: SweepSummary, name: str, failure: str | None) -> None:
    if failure is None:
        summary.num_measured += 1
    else:
        summary.failures.append((name, failure))
        _LOG.warning("%s failed: %s", name, failure)
