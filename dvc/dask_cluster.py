"""Dask clusters: connect, and require workers with the same code and libraries."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from dvc import cli
from dvc.errors import DvcError
from dvc.versions import codec_digest, library_versions

if TYPE_CHECKING:
    from distributed import Client

CONNECT_S = 10.0
WORKERS_S = 30.0
OTHER_CODE = "the worker has another version of the code"
_LARGE_GRAPHS = "distributed.admin.large-graph-warning-threshold"


@contextmanager
def connected(address: str, digest: str) -> Iterator["Client"]:
    """Connect to a cluster; its workers must have code of a digest, and the libraries of this process."""
    try:
        import dask
        from distributed import Client
    except ImportError as err:
        raise DvcError("--dask needs the package `distributed`: pip install 'dvc3d[dask]'") from err
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError, ImportError) as err:
        raise DvcError(f"no Dask scheduler answers at {address!r}: {err}") from err
    with client, dask.config.set({_LARGE_GRAPHS: "1GiB"}):  # pictures go with their task: it may run again
        require_workers(client)
        try:
            digests, libraries = client.run(codec_digest), client.run(library_versions)
        except ImportError as err:
            raise DvcError(f"a worker of the Dask cluster cannot load the codec: {err}") from err
        for worker, other in digests.items():
            if other != digest:
                versions = f"{other[:12]}, not {digest[:12]}"
                raise DvcError(f"worker {worker} has another version of the code ({versions})")
            for name, version in library_versions().items():
                installed = libraries[worker].get(name, "missing")
                if installed != version:
                    raise DvcError(f"worker {worker} has {name} {installed}, not {version}")
        yield client


def require_workers(client: "Client") -> None:
    """Wait for a worker until a timeout."""
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError as err:
        address = client.scheduler.address if client.scheduler is not None else ""
        raise DvcError(f"the Dask cluster at {address!r} has no workers") from err


def failure_text(error: BaseException, work: str) -> str:
    """Return in one line why the cluster did not do some work."""
    if isinstance(error, (DvcError, OSError)):
        return cli.one_line(error)
    if type(error).__name__ == "KilledWorker":
        return f"several workers were lost while they {work}"
    if type(error).__name__ == "FutureCancelledError":
        return "the Dask scheduler was lost"
    return cli.one_line(f"{type(error).__name__}: {error}")
