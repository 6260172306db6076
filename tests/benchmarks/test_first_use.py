"""The first use of a wheel compiles nothing."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import first_use

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_first_use_compiles_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The wheel of this tree, installed and used, finds all kernels that it needs."""
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(tmp_path)]
    subprocess.run([sys.executable, "-m", "pip", "wheel", *options, "."], cwd=ROOT, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    assert first_use.main([str(wheel), "--out", str(tmp_path / "used")]) == 0
    assert ", 0 compiled" in capfd.readouterr().out
    subprocess.run(["chmod", "-R", "u+w", tmp_path], check=True)  # for who removes it
