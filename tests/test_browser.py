"""The search for a browser: which one is taken, how one is installed, and what happens without one."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests import browser
from tests.waiting import wait_until

PAGE = "echo '<html><head></head><body></body></html>'"
Fake = Callable[..., str]


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fake:
    """Return a function that makes a program; the search sees no others, and thinks that it is root."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.setenv("PLAYWRIGHT_BROWSERS_PATH", str(tmp_path / "downloads"))
    monkeypatch.delenv(browser.NAMED, raising=False)
    monkeypatch.delenv(browser.REQUIRED, raising=False)
    monkeypatch.setattr(os, "geteuid", lambda: 0)

    def make(name: str, script: str, where: Path = folder) -> str:
        where.mkdir(parents=True, exist_ok=True)
        path = where / name
        path.write_text(f"#!/bin/sh\nPATH={folder}:/usr/bin:/bin\n{script}\n")
        path.chmod(0o755)
        return str(path)

    return make


def is_running(number: int) -> bool:
    """Tell whether a process has not ended; one that nobody has waited for yet has."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize("name", browser.COMMANDS)
def test_commands_are_found(fake: Fake, name: str) -> None:
    assert browser.find() is None
    path = fake(name, PAGE)
    assert browser.find() == path


def test_browser_must_start(fake: Fake, tmp_path: Path) -> None:
    """One that fails, shows nothing, or is no program gives way to the next, at last to Playwright's."""
    fake("chromium", f"{PAGE}; exit 1")
    fake("chromium-browser", "exit 0")
    Path(fake("google-chrome", "")).write_bytes(b"\x00not a program")
    assert browser.find() is None
    path = fake(
        "chrome-headless-shell", PAGE, tmp_path / "downloads" / "chromium_headless_shell-9" / "linux64"
    )
    assert browser.find() == path


def test_browser_that_hangs_is_given_up(fake: Fake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    noted = tmp_path / "processes"
    fake("chromium", f"sleep 6000 & echo $$ $! > {noted}.new; mv {noted}.new {noted}; sleep 6000")
    monkeypatch.setattr(browser, "START_LIMIT_S", 0.5)
    while not noted.exists():  # it may be given up before it has begun
        assert browser.find() is None
    for number in noted.read_text().split():
        wait_until(lambda number=number: not is_running(int(number)))


def test_named_browser_is_the_only_one(fake: Fake, monkeypatch: pytest.MonkeyPatch) -> None:
    """A browser that the user names and that does not start is neither replaced nor installed."""
    fake("chromium", PAGE)
    monkeypatch.setenv(browser.NAMED, fake("mine", "exit 1"))
    monkeypatch.setattr(browser, "install", lambda: pytest.fail("installed"))
    assert browser.find() is None
    assert "mine" in browser.missing()
    assert browser.main() == 0
    fake("mine", PAGE)
    assert browser.find() == os.environ[browser.NAMED]


def test_download_comes_before_the_package(
    fake: Fake, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "downloads" / "chromium_headless_shell-9" / "linux64"
    path = fake("chrome-headless-shell", "exit 1", folder)
    script = f"printf '#!/bin/sh\\n%s\\n' \"{PAGE}\" > {path}"
    monkeypatch.setattr(sys, "executable", fake("python", script))
    fake("apt-get", f"touch {tmp_path}/asked")
    assert browser.main() == 0
    assert path in capsys.readouterr().out
    assert not (tmp_path / "asked").exists()


def install_script(tmp_path: Path) -> str:
    """Return a package manager that writes down what it is asked and installs a browser."""
    return (
        f'echo "$@" >> {tmp_path}/asked\n'
        f'case "$*" in *install*) printf \'#!/bin/sh\\n%s\\n\' "{PAGE}" > {tmp_path}/bin/chromium;'
        f" chmod +x {tmp_path}/bin/chromium;; esac"
    )


def test_root_installs_the_package(fake: Fake, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Where the download fails, root installs the distribution's package after reading its lists."""
    monkeypatch.setattr(sys, "executable", fake("python", "exit 1"))
    for name in ("timeout", "env"):
        fake(name, f'exec /usr/bin/{name} "$@"')
    fake("apt-get", install_script(tmp_path))
    assert browser.main() == 0
    asked = (tmp_path / "asked").read_text().splitlines()
    assert len(asked) == 2
    assert asked[0].endswith("update")
    assert asked[1].endswith("chromium")


@pytest.mark.parametrize("allowed", [False, True])
def test_user_needs_sudo(
    fake: Fake, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *, allowed: bool
) -> None:
    """A user installs the package through sudo if that asks for no password, and not otherwise."""
    monkeypatch.setattr(sys, "executable", fake("python", "exit 1"))
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    fake("apt-get", install_script(tmp_path))
    fake("sudo", 'shift; exec "$@"' if allowed else "exit 1")
    assert browser.main() == 0
    assert (browser.find() is not None) == allowed == (tmp_path / "asked").exists()


@pytest.mark.parametrize(("required", "status", "word"), [("", 0, "are skipped"), ("1", 1, "fail")])
def test_without_a_browser_one_line_says_so(
    fake: Fake,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    required: str,
    status: int,
    word: str,
) -> None:
    """Nothing found and nothing to be installed: tests are skipped, or fail where a browser is required."""
    monkeypatch.setattr(sys, "executable", fake("python", "exit 1"))
    monkeypatch.setenv(browser.REQUIRED, required)
    assert browser.main() == status
    assert capsys.readouterr().err.splitlines()[-1] == f"{browser.missing()}; tests of the report page {word}"


@pytest.mark.parametrize(("required", "status", "word"), [("", 0, "SKIPPED"), ("1", 1, "ERROR")])
def test_page_tests_follow(tmp_path: Path, required: str, status: int, word: str) -> None:
    variables = {browser.NAMED: str(tmp_path / "none"), browser.REQUIRED: required, "COLUMNS": "500"}
    tests = ["tests/rd/test_page_browser.py", "-n", "0", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *tests, "-k", "chart_zooms or fits"],
        env={**os.environ, **variables},
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == status, done.stdout
    lines = [line for line in done.stdout.splitlines() if line.startswith(word)]
    assert len(lines) == (1 if word == "SKIPPED" else 2)
    assert all("none', a browser that does not start" in line for line in lines)
