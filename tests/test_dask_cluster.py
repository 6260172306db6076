"""Messages about work that a cluster did not do."""

import pytest

from dvc.dask_cluster import failure_text
from dvc.errors import DvcError


class KilledWorker(Exception):
    """Named as what Dask raises."""


class FutureCancelledError(Exception):
    """Named as what Dask raises."""


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (DvcError("no\nroom"), "no room"),
        (KilledWorker(), "several workers were lost while they measured this point"),
        (FutureCancelledError(), "the Dask scheduler was lost"),
        (KeyError("a"), "KeyError: 'a'"),
    ],
)
def test_failures_are_one_line(error: Exception, line: str) -> None:
    assert failure_text(error, "measured this point") == line
