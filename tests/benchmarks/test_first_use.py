"""The first use of a wheel: it is pure, and compiles kernels into the user's cache."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import first_use

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_first_use(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(tmp_path)]
    subprocess.run([sys.executable, "-m", "pip", "wheel", *options, "."], cwd=ROOT, check=True)
    (wheel,) = tmp_path.glob("*-py3-none-any.whl")
    assert first_use.main([str(wheel), "--out", str(tmp_path / "used")]) == 0
    assert "first decoded frame" in capfd.readouterr().out
    assert list((tmp_path / "used" / "home" / ".cache" / "dvc3d" / "kernels").rglob("*.nbc"))
