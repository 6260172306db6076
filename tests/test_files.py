"""Tests of files that appear complete or not at all."""

import errno
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest

from dvc.errors import DvcError
from dvc.files import (
    SyncedFile,
    atomic_folder,
    atomic_output,
    check_folder,
    growing_output,
    read_whole,
    same_file,
)


def test_file_appears_only_after_success(tmp_path: Path) -> None:
    target = tmp_path / "out.bin"
    target.write_bytes(b"old")
    with atomic_output(target) as temporary:
        temporary.write_bytes(b"new")
        assert target.read_bytes() == b"old"
        assert temporary.parent == tmp_path
    assert target.read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["out.bin"]


def fail_in(output: AbstractContextManager[Path | SyncedFile], error: type[BaseException]) -> None:
    """Expect an exception to pass through after half of a file was written."""

    def write_half() -> None:
        with output as target:
            (target.write_bytes if isinstance(target, Path) else target.write)(b"half")
            raise error

    with pytest.raises(error):
        write_half()


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_failure_leaves_nothing(tmp_path: Path, error: type[BaseException]) -> None:
    fail_in(atomic_output(tmp_path / "out.bin"), error)
    assert os.listdir(tmp_path) == []


def test_visible_output_shows_while_it_is_written(tmp_path: Path) -> None:
    with atomic_output(tmp_path / "out.dvc", visible=True) as temporary:
        assert temporary == tmp_path / "out.dvc.part"
    assert os.listdir(tmp_path) == ["out.dvc"]


_WRITER = """
import sys, time
from dvc import cli
from dvc.files import atomic_output
def work():
    with atomic_output(sys.argv[1], visible=len(sys.argv) > 2) as temporary:
        temporary.write_bytes(b"half")
        print(flush=True)
        time.sleep(60)
sys.exit(cli.run("writer", work))
"""


@contextmanager
def another_writer(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    """Start a program that is in the middle of writing a file."""
    command = [sys.executable, "-c", _WRITER, *map(str, arguments)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:  # type: ignore[call-overload]
        assert process.stdout.readline() == "\n"
        yield process
        process.kill()


@pytest.mark.parametrize("visible", [(), ("visible",)])
def test_termination_leaves_nothing(tmp_path: Path, visible: tuple[str, ...]) -> None:
    with another_writer(tmp_path / "out.bin", *visible) as process:
        assert len(os.listdir(tmp_path)) == 1
        process.send_signal(signal.SIGTERM)
        _, stderr = process.communicate(timeout=60)
    assert (process.returncode, stderr) == (143, "writer: terminated\n")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("visible", [False, True])
def test_second_writer_is_refused(tmp_path: Path, visible: bool) -> None:
    target = tmp_path / "out.bin"

    def write() -> None:
        with atomic_output(target, visible=visible) as temporary:
            temporary.write_bytes(b"second")

    with atomic_output(target, visible=visible) as temporary:
        temporary.write_bytes(b"first")
        with pytest.raises(DvcError, match=r"cannot write .*out\.bin: another program is writing it"):
            write()
    assert target.read_bytes() == b"first"
    write()
    assert target.read_bytes() == b"second"


def test_dead_writers_block_no_other(tmp_path: Path) -> None:
    target = tmp_path / "out.bin"
    for visible in ((), ("visible",), ("visible",)):
        with another_writer(target, *visible) as process:
            process.kill()
        with atomic_output(target, visible=bool(visible)) as temporary:
            assert temporary.read_bytes() == b""
    assert sorted(os.listdir(tmp_path)) == ["out.bin", "out.bin.1.part", "out.bin.2.part"]
    assert (tmp_path / "out.bin.2.part").read_bytes() == b"half"


def test_disk_has_a_file_before_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[object] = []
    for name in ("fsync", "replace"):
        work = getattr(os, name)
        monkeypatch.setattr(os, name, lambda *given, name=name, work=work: (steps.append(name), work(*given)))
    with atomic_output(tmp_path / "out.bin") as temporary:
        temporary.write_bytes(b"data")
    assert steps == ["fsync", "replace", "fsync"]


def test_long_names_are_written(tmp_path: Path) -> None:
    """Names as long as the file system takes do not fail for the time of writing, nor meet each other."""
    names = ["x" * 250 + end for end in ("a.bin", "b.bin")]
    with atomic_output(tmp_path / names[0]) as first, atomic_output(tmp_path / names[1]) as second:
        assert first != second
    assert sorted(os.listdir(tmp_path)) == names


def test_growing_file_is_renamed_when_it_is_finished(tmp_path: Path) -> None:
    """Every write is in the file when it returns, under the partial name until the end."""
    with growing_output(tmp_path / "out.bin") as file:
        for count in range(1, 4):
            file.write(b"0123456789")
            assert (tmp_path / "out.bin.part").stat().st_size == 10 * count
    assert os.listdir(tmp_path) == ["out.bin"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, OSError])
def test_failure_leaves_what_was_written(tmp_path: Path, error: type[BaseException]) -> None:
    fail_in(growing_output(tmp_path / "out.bin"), error)
    assert os.listdir(tmp_path) == ["out.bin.part"]
    assert (tmp_path / "out.bin.part").read_bytes() == b"half"


@pytest.mark.parametrize("name", ["out.bin", "out.bin.part"])
def test_growing_file_replaces_nothing(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"old")
    with pytest.raises(DvcError, match="exists"), growing_output(tmp_path / "out.bin") as file:
        file.write(b"new")
    assert (tmp_path / name).read_bytes() == b"old"


def test_synced_writes_to_what_cannot_be_synced() -> None:
    with SyncedFile(Path(os.devnull)) as file:
        assert file.write(b"data") == 4


@pytest.mark.parametrize("waits", [True, False])
def test_synced_waits_for_the_disk_where_it_shall(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, waits: bool
) -> None:
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", synced.append)
    with SyncedFile(tmp_path / "out.bin", waits=waits) as file:
        file.write(b"data")
        assert (tmp_path / "out.bin").read_bytes() == b"data"
        assert len(synced) == waits


@pytest.mark.parametrize("output", [atomic_output, atomic_folder])
def test_full_disk_is_one_clear_error(
    tmp_path: Path, output: Callable[[Path], AbstractContextManager[Path]]
) -> None:
    """A full disk names the target, not the temporary file; an error about another file keeps its type."""
    message = r"^cannot write .*/out: No space left on device$"
    with pytest.raises(DvcError, match=message), output(tmp_path / "out"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(FileNotFoundError), output(tmp_path / "out"):
        (tmp_path / "absent").read_bytes()
    assert os.listdir(tmp_path) == []


def test_missing_folder_and_folder_as_target_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DvcError, match="does not exist"), atomic_output(tmp_path / "absent" / "x"):
        pass
    with pytest.raises(DvcError, match="is a folder"), atomic_output(tmp_path):
        pass


def test_permissions_are_those_of_any_new_file(tmp_path: Path) -> None:
    with atomic_output(tmp_path / "a"):
        pass
    (tmp_path / "b").touch()
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode


def test_symbolic_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with atomic_output(tmp_path / "link") as temporary:
        temporary.write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"


def test_device_is_written_to_directly() -> None:
    with atomic_output("/dev/null") as path:
        path.write_bytes(b"gone")
    assert Path("/dev/null").is_char_device()


def test_same_file_sees_through_names(tmp_path: Path) -> None:
    real = tmp_path / "real"
    real.touch()
    (tmp_path / "link").symlink_to(real)
    os.link(real, tmp_path / "hard")
    assert same_file(real, tmp_path / "link")
    assert same_file(real, tmp_path / "hard")
    assert same_file(tmp_path / "new", tmp_path / "." / "new")
    assert not same_file(real, tmp_path / "new")
    assert not same_file(tmp_path / "new", tmp_path / "newer")


def test_folders_appear_whole(tmp_path: Path) -> None:
    """A folder in use is refused, before any work as well; after an exception nothing is left."""
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "file").touch()
    (tmp_path / "empty").mkdir()
    for name, message in (
        ("used", "not an empty folder"),
        ("used/file", "not an empty folder"),
        ("none/here", "does not exist"),
    ):
        for use in (check_folder, lambda path: atomic_folder(path).__enter__()):
            with pytest.raises(DvcError, match=f"cannot write .*{message}"):
                use(tmp_path / name)
    for name in ("empty", "new"):
        check_folder(tmp_path / name)
        with atomic_folder(tmp_path / name) as folder:
            (folder / "y").touch()
        assert (tmp_path / name / "y").exists()
    with pytest.raises(KeyError), atomic_folder(tmp_path / "failed"):
        raise KeyError
    assert not list(tmp_path.glob("*failed*"))


@pytest.mark.parametrize("name", [".", "", "..", "/", "empty/.."])
def test_folder_without_a_name_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    with pytest.raises(DvcError, match="it has no name"):
        check_folder(name)


def test_what_never_ends_is_not_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "some"
    path.write_bytes(b"content")
    assert read_whole(path) == b"content"
    reading, writing = os.pipe()
    os.write(writing, b"piped")
    os.close(writing)
    assert read_whole(f"/dev/fd/{reading}") == b"piped"
    os.close(reading)
    with pytest.raises(DvcError, match=r"^/dev/zero: not a file, and more than 64 MiB$"):
        read_whole("/dev/zero")
