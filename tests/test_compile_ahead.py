"""Kernels compiled ahead: the lists hold what programs call, and the processes leave nothing behind."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

import decoder.__main__ as decoder
import encoder.__main__ as encoder
from dvc import compile_ahead
from dvc.compile_ahead import Kernel, compile_part, compiling_ahead, listed
from tests.golden_streams import GOLDEN, Golden, digest, records, source

NAMES = (
    "2d-colour",
    "3d-fused",
    "3d-td-all",
    "3d-te-odd",
    "2d-qp",
    "3d-te-qp",
    "3d-te-p-type",
)
CODECS = [golden for name in NAMES for golden in GOLDEN if golden.name == name]
LISTS = {"decoder": decoder.KERNELS, "encoder": encoder.KERNELS}
MODULE = "from dvc._jit import kernel\n@kernel\ndef {0}(x):\n    return x + 1\n"


def recorded(*arguments: object) -> list[str]:
    """Return what a program calls, as lines of a list."""
    command = [sys.executable, "-m", "tests.recorder", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def calls(program: str, codecs: Sequence[Golden], folder: Path) -> list[str]:
    """Return what a program calls to make or decode frozen streams."""
    arguments: list[object] = []
    for golden in codecs:
        if program == "decoder":
            arguments += ["--", golden.path("buffered")]
        else:
            (folder / golden.name).mkdir()
            arguments += ["--", source(golden, folder / golden.name), *golden.coding.split()]
    return recorded(program, *arguments)


@pytest.mark.parametrize("program", LISTS)
@pytest.mark.parametrize("codecs", [CODECS[:-1], CODECS[-1:]], ids=["others", "default"])
def test_lists_hold_what_programs_call(program: str, codecs: Sequence[Golden], tmp_path: Path) -> None:
    """Every kernel that Python calls is listed with its types; `DVC_REGENERATE=1` adds what is missing."""
    called = calls(program, codecs, tmp_path)
    kept = LISTS[program].read_text(encoding="utf-8").splitlines()
    if os.environ.get("DVC_REGENERATE") == "1":
        kept = [line for line in kept if line not in called] + called
        LISTS[program].write_text("".join(f"{line}\n" for line in kept), encoding="utf-8")
    assert set(called) <= set(kept)


def test_lists_hold_what_live_runs_call(tmp_path: Path) -> None:
    """What an encoder calls that answers a decoder is listed, and what flow control does at both ends."""
    golden = CODECS[-1]
    called = recorded("live", source(golden, tmp_path), *golden.coding.split())
    flow_control = [line for line in called if line.startswith("dvc.feedback._kernels enter")]
    assert len(flow_control) == 2
    for program, lines in (("encoder", called), ("decoder", flow_control)):
        kept = LISTS[program].read_text(encoding="utf-8").splitlines()
        missing = [line for line in lines if line not in kept]
        if os.environ.get("DVC_REGENERATE") == "1":
            LISTS[program].write_text("".join(f"{line}\n" for line in missing + kept), encoding="utf-8")
            missing = []
        assert not missing


@pytest.mark.parametrize("program", LISTS)
def test_listed_kernels_compile(program: str) -> None:
    """No line names what is no more, and afterwards nothing counts as missing on disk."""
    for kernel in listed(LISTS[program]):
        kernel.compile()
    assert not compile_ahead._missing(LISTS[program])


@pytest.fixture
def fake_list(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a list of a package with two kernels, in a folder without compiled ones."""
    package = tmp_path / "fake_package"
    package.mkdir()
    (package / "__init__.py").touch()
    for name in ("first", "last"):
        (package / f"{name}.py").write_text(MODULE.format(name))
    lines = ["fake_package.first first (int64,)", "fake_package.last last (int64,)"]
    path = package / "kernels.txt"
    path.write_text("\n".join([*lines, "fake_package.last gone (int64,)", "broken", "a b c(d"]))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "compiled"))
    monkeypatch.delenv("NUMBA_DISABLE_JIT", raising=False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _process: {0, 1, 2})
    return path


def compiled(path: Path) -> set[str]:
    """Return which fake kernels are on disk."""
    return {file.name.split(".")[0] for file in (path.parents[1] / "compiled").rglob("*.nbi")}


def children() -> set[str]:
    """Return the processes that this one has started and not waited for."""
    return set(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())


def wait_for(path: Path, names: set[str]) -> None:
    """Wait until kernels are on disk."""
    end = time.monotonic() + 60
    while compiled(path) != names and time.monotonic() < end:
        time.sleep(0.05)
    assert compiled(path) == names


def test_lists_are_read_line_by_line(fake_list: Path) -> None:
    """Lines of other forms are left out."""
    assert listed(fake_list)[0] == Kernel("fake_package.first", "first", "(int64,)")
    assert len(listed(fake_list)) == 4


def test_spare_cores_compile_what_is_missing(fake_list: Path) -> None:
    """Two processes share a list, skip what cannot be compiled, and are gone in the end."""
    before = children()
    with compiling_ahead(fake_list):
        assert len(children() - before) == 2
        wait_for(fake_list, {"first", "last"})
    assert children() == before


def test_what_is_on_disk_is_not_missing(fake_list: Path) -> None:
    """Nothing is started where all has been compiled, no core is spare or the JIT is off."""
    fake_list.write_text("".join(f"fake_package.{name} {name} (int64,)\n" for name in ("first", "last")))
    assert compile_ahead._missing(fake_list)
    before = children()
    with compiling_ahead(fake_list, num_busy=3):
        assert children() == before
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NUMBA_DISABLE_JIT", "1")
        with compiling_ahead(fake_list):
            assert children() == before
    with compiling_ahead(fake_list):
        wait_for(fake_list, {"first", "last"})
    assert not compile_ahead._missing(fake_list)
    with compiling_ahead(fake_list):
        assert children() == before


def test_nothing_is_compiled_for_nobody(fake_list: Path) -> None:
    """A process whose parent has ended ends, too."""
    compile_part(fake_list, 0, 1, parent=0)
    assert compiled(fake_list) == set()


@pytest.mark.parametrize("killed", [False, True])
def test_decoding_is_not_harmed(killed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a process that compiles, or is killed, frames are the same and none is left behind."""
    monkeypatch.setattr(compile_ahead, "_missing", lambda _path: True)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _process: {0, 1})
    started = []
    start = compile_ahead._start

    def start_and_kill(*arguments: object) -> subprocess.Popen[bytes]:
        process = start(*arguments)  # type: ignore[arg-type]
        if killed:
            process.send_signal(signal.SIGKILL)
        started.append(process)
        return process

    monkeypatch.setattr(compile_ahead, "_start", start_and_kill)
    path, video = CODECS[0].path("buffered"), tmp_path / "video.y4m"
    assert decoder.main([str(path), str(video), "--quiet"]) == 0
    assert digest(video) == records()[path.name]["video_sha256"]
    assert [process.returncode is not None for process in started] == [True]
