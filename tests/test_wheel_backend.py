"""The wheel: it holds compiled kernels, by which it is named, and an installed package compiles nothing."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

import wheel_backend

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("dvc", "encoder", "decoder", "sequences", "sfm")
FILES = ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE", "dvc3d.py", "wheel_backend.py")
SHORT_LIST = "dvc.wynerziv._kernels logarithm (float64,)\n"
CALL = (
    "from dvc.wynerziv._kernels import logarithm as f; print(f(1.5), len(f.stats.cache_hits), f.__module__)"
)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of what a wheel is made of, with one kernel listed."""
    folder = tmp_path_factory.mktemp("source")
    for package in PACKAGES:
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    for file in FILES:
        shutil.copy(ROOT / file, folder)
    (folder / "dvc" / "kernels.txt").write_text(SHORT_LIST)
    return folder


def built(hook: str, source: Path, folder: Path) -> Path:
    """Call a hook of the backend as pip does; return what it has built."""
    code = f"import wheel_backend; print(wheel_backend.{hook}({str(folder)!r}))"
    own = {"PYTHONPATH": str(source), "PYTHONSAFEPATH": "1", "NUMBA_CACHE_DIR": str(folder / "not-there")}
    environment = os.environ | own
    command = [sys.executable, "-c", code]
    run = subprocess.run(command, cwd=source, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return folder / run.stdout.splitlines()[-1]


def test_wheel_holds_compiled_kernels(source: Path, tmp_path: Path) -> None:
    """What is listed is in the wheel, without what it calls; where that is unpacked, nothing is compiled."""
    wheel = built("build_wheel", source, tmp_path)
    assert f"-cp{sys.version_info.major}{sys.version_info.minor}-none-linux_" in wheel.name
    with ZipFile(wheel) as archive:
        cached = [Path(name) for name in archive.namelist() if "__pycache__" in name]
        archive.extractall(tmp_path / "installed")
    assert {(path.parts[1], path.name.split("-")[0], path.suffix) for path in cached} == {
        ("wynerziv", "_kernels.logarithm", ".nbi"),
        ("wynerziv", "_kernels.logarithm", ".nbc"),
    }
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "installed"), "NUMBA_CACHE_DIR": str(tmp_path)}
    run = subprocess.run(
        [sys.executable, "-c", CALL],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.split() == ["0.4054651081081644", "1", "dvc.wynerziv._kernels"]
    assert sum(path.suffix == ".nbi" for path in tmp_path.rglob("*")) == 1


def test_other_builds_compile_nothing(source: Path, tmp_path: Path) -> None:
    """An editable wheel needs no libraries and holds no kernels; an archive of sources holds the backend."""
    assert not any(name.startswith("numba") for name in wheel_backend.get_requires_for_build_editable())
    assert any(name.startswith("numba") for name in wheel_backend.get_requires_for_build_wheel())
    with ZipFile(built("build_editable", source, tmp_path)) as wheel:
        assert [name for name in wheel.namelist() if "__pycache__" in name] == []
    shutil.unpack_archive(built("build_sdist", source, tmp_path), tmp_path)
    (unpacked,) = tmp_path.glob("dvc3d-*/")
    assert all((unpacked / name).is_file() for name in FILES)
    shipped = [path for package in PACKAGES for path in (source / package).rglob("*.*") if path.is_file()]
    lacking = {
        path.relative_to(source) for path in shipped if not (unpacked / path.relative_to(source)).exists()
    }
    assert {path for path in lacking if "__pycache__" not in path.parts} == set()
