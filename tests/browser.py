"""The browser that the report page is tested in: found, or installed by ``python -m tests.browser``."""

import ctypes
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Page

NAMED = "DVC_CHROMIUM"
"""Variable that names the browser; no other is tried then."""
REQUIRED = "DVC_REQUIRE_BROWSER"
"""Variable that makes tests without a browser fail instead of being skipped."""
COMMANDS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
DOWNLOADED = ("chromium*/*/chrome", "chromium*/*/headless_shell", "chromium*/*/chrome-headless-shell")
ARGUMENTS = (
    "--headless",
    "--no-sandbox",  # root has to
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
GRAPHICS_ARGUMENTS = (
    *(argument for argument in ARGUMENTS if argument != "--disable-gpu"),
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
"""With WebGL 2, drawn by the processor."""
START_LIMIT_S = 30
WAIT_LIMIT_S = 60
INSTALL_LIMIT_S = 600
_PR_CAPBSET_DROP, _CAP_SYS_NICE = 24, 23
_APT_GET = ("apt-get", "-q", "-o", "Acquire::http::Timeout=10", "-o", "DPkg::Lock::Timeout=60")
PACKAGE_MANAGERS: dict[str, tuple[tuple[str, ...], ...]] = {
    "apt-get": ((*_APT_GET, "update"), (*_APT_GET, "install", "-y", "--no-install-recommends", "chromium")),
    "dnf": (("dnf", "install", "-y", "chromium"),),
}


def find() -> str | None:
    """Return the path of a browser that starts, or None."""
    return next((path for path in _candidates() if starts(path)), None)


def missing() -> str:
    """Say in one line what `find` has not found."""
    named = os.environ.get(NAMED)
    if named:
        return f"{NAMED} names {named!r}, a browser that does not start"
    return f"no browser that starts: install chromium, or name one in {NAMED}"


def is_required() -> bool:
    """Tell whether tests without a browser fail."""
    return os.environ.get(REQUIRED, "") not in ("", "0")


def starts(path: str) -> bool:
    """Tell whether a program is a browser that can show an empty page here."""
    with tempfile.TemporaryDirectory() as profile:
        command = [path, *ARGUMENTS, f"--user-data-dir={profile}", "--dump-dom", "about:blank"]
        return b"<html" in (_output(command, START_LIMIT_S) or b"")


def install() -> None:
    """Try to get a browser: Playwright's own, else the distribution's package where this user may."""
    patience = {"PLAYWRIGHT_DOWNLOAD_CONNECTION_TIMEOUT": "10000"}
    _output([sys.executable, "-m", "playwright", "install", "--only-shell", "chromium"], variables=patience)
    if find() is not None:
        return
    as_root = _as_root()
    manager = next(filter(shutil.which, PACKAGE_MANAGERS), None)
    if as_root is None or manager is None:
        return
    for command in PACKAGE_MANAGERS[manager]:
        limit = ("timeout", "--kill-after=10", str(INSTALL_LIMIT_S))  # only root may end what runs as root
        quiet = ("env", "DEBIAN_FRONTEND=noninteractive")
        _output([*as_root, *limit, *quiet, *command], 2 * INSTALL_LIMIT_S)


def main() -> int:
    """Find a browser or install one; return 1 if there is none and tests need it."""
    path = find()
    if path is None and not os.environ.get(NAMED):
        sys.stderr.write("no browser that starts: trying to install one\n")
        install()
        path = find()
    if path is not None:
        sys.stdout.write(f"tests of the report page use {path}\n")
        return 0
    sys.stderr.write(f"{missing()}; tests of the report page {'fail' if is_required() else 'are skipped'}\n")
    return int(is_required())


def deny_real_time() -> None:
    """Keep programs that are started from now on from real-time priority, which root's browser would take."""
    if sys.platform == "linux":
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        ctypes.CDLL(None).prctl(_PR_CAPBSET_DROP, _CAP_SYS_NICE, 0, 0, 0)


def wait_until(page: "Page", condition: str) -> None:
    """Wait until an expression is true in a page; its policy forbids what Playwright's own waiting needs."""
    deadline = time.monotonic() + WAIT_LIMIT_S
    while not page.evaluate(condition):
        if time.monotonic() > deadline:
            raise TimeoutError(f"still not true after {WAIT_LIMIT_S} s: {condition}")
        page.wait_for_timeout(20)


def _candidates() -> Iterator[str]:
    if named := os.environ.get(NAMED):
        yield named
        return
    yield from filter(None, map(shutil.which, COMMANDS))
    downloads = Path(os.environ.get("PLAYWRIGHT_BROWSERS_PATH") or "~/.cache/ms-playwright").expanduser()
    for pattern in DOWNLOADED:
        yield from map(str, sorted(downloads.glob(pattern), reverse=True))


def _as_root() -> list[str] | None:
    """Return what makes a command run as root without asking; None where nothing does."""
    if os.geteuid() == 0:
        return []
    sudo = ["sudo", "-n"]
    return sudo if _output([*sudo, "true"], START_LIMIT_S) is not None else None


def _output(
    command: Sequence[str], limit_s: float = INSTALL_LIMIT_S, variables: Mapping[str, str] | None = None
) -> bytes | None:
    """Return what a command writes; None if it fails, cannot be started, or takes too long."""
    with tempfile.TemporaryFile() as output:
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **(variables or {})},
                start_new_session=True,
            )
        except OSError:
            return None
        try:
            status = process.wait(limit_s)
        except subprocess.TimeoutExpired:
            status = None
        finally:
            _end(process)
        output.seek(0)
        return output.read() if status == 0 else None


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End a process and its children, whatever is left of them."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        process.kill()
    process.wait()


if __name__ == "__main__":
    sys.exit(main())
