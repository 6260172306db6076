"""Libraries of a process that is started with the baseline environment run the same code on any processor."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dvc.environment import ONE_HEAP, baseline_environment, child_environment, without_settings

REPORT = """
import json
import cv2
import numpy as np
print(json.dumps({
    "numpy": np.show_config(mode="dicts")["SIMD Extensions"].get("found", []),
    "opencv": [name for name in cv2.getCPUFeaturesLine().split() if name.startswith("*")],
    "ipp": cv2.ipp.useIPP(),
    "threads": cv2.getNumThreads(),
}))
"""
FAULTS = """
import resource
import numpy as np
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(100):
    np.ones(1 << 17)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def report() -> dict[str, object]:
    """Return what libraries say of themselves in the baseline environment."""
    command = [sys.executable, "-c", REPORT]
    done = subprocess.run(command, env=baseline_environment(), capture_output=True, text=True, check=True)
    found: dict[str, object] = json.loads(done.stdout)
    return found


def test_libraries_find_no_more_than_the_baseline(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the environment says, numpy dispatches nothing, OpenCV nothing above SSE4.2, on one thread."""
    monkeypatch.setenv("NPY_ENABLE_CPU_FEATURES", "X86_V3")
    monkeypatch.setenv("OPENCV_CPU_DISABLE", "")
    monkeypatch.setenv("OPENCV_IPP", "avx2")
    monkeypatch.setenv("OPENCV_FOR_THREADS_NUM", "2")
    found = report()
    assert found["numpy"] == []
    assert all(name.endswith("?") or "SSE" in name for name in found["opencv"])
    assert not found["ipp"]
    assert found["threads"] == 1


def test_baseline_is_stated_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the calling environment sets for the libraries does not count, all else stays."""
    monkeypatch.setenv("DVC_SOMETHING", "else")
    plain = baseline_environment()
    for name in ("OPENBLAS_CORETYPE", "OPENCV_CPU_DISABLE", "GLIBC_TUNABLES", "NPY_DISABLE_CPU_FEATURES"):
        monkeypatch.setenv(name, "other")
    assert baseline_environment() == plain
    assert plain["DVC_SOMETHING"] == "else"


def test_shared_libraries_are_not_looked_for_in_the_current_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LD_LIBRARY_PATH", ":/one::/two:")
    assert child_environment()["LD_LIBRARY_PATH"] == "/one:/two"
    with without_settings("any"):
        assert os.environ["LD_LIBRARY_PATH"] == "/one:/two"
    monkeypatch.setenv("LD_LIBRARY_PATH", ":")
    assert child_environment()["LD_LIBRARY_PATH"] == ""
    monkeypatch.delenv("LD_LIBRARY_PATH")
    assert "LD_LIBRARY_PATH" not in child_environment()


def test_settings_are_hidden_for_a_while(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("settings", "other"):
        Path(name).touch()
    with without_settings("settings"):
        assert not os.path.exists("settings")
        assert os.path.exists("other")
        assert os.path.exists(tmp_path / "settings")
    assert os.path.exists("settings")


def test_memory_is_kept_whatever_the_parent_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a Dask worker has arrays mapped anew each time, processes that decode do not."""
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")
    command = [sys.executable, "-c", FAULTS]
    faults = [
        int(subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout)
        for environment in (baseline_environment() | ONE_HEAP, baseline_environment())
    ]
    assert faults[0] < 0.1 * faults[1]
