"""Change copies of the packages in random positions, and list the changes that no test notices.

A change is noticed if the tests of its package, or the canaries of the codec, fail; they stop at the first
failure, and after --limit seconds nothing counts. Outcomes are stored, so that a new run continues.
"""

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import Any

from benchmarks.mutants.operators import NAMED, OPERATORS, Change, changes, named_change
from dvc.environment import child_environment, python_module

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = (
    "encoder",
    "decoder",
    "dvc/tracks",
    "dvc/slepian_wolf",
    "dvc/wynerziv",
    "dvc/geometry",
    "dvc/images",
    "dvc/layers",
    "dvc/dibr",
    "dvc/stereo",
    "sfm",
)
CODEC = (*PACKAGES[:6], "dvc/config", "sfm")
"""Packages that the canaries are coded with."""
COMMAND_LINES = ("__main__.py", "options.py", "encoder_options.py", "commands")
"""Modules without changes: their numbers are bounds and widths of text."""
CANARIES = "tests/test_canaries.py"
CONTRACTS = ["tests/contracts", "tests/test_extensions.py"]


def sources(package: str) -> list[Path]:
    """List the sources of a package that are changed."""
    found = (ROOT / package).rglob("*.py")
    return sorted(path for path in found if not {*path.relative_to(ROOT).parts} & {*COMMAND_LINES})


def drawn(count: int, seed: int) -> list[Change]:
    """Draw changes: every package and operator as often, then any place."""
    rng, found = random.Random(seed), list[Change]()
    places: dict[tuple[str, str], list[Change]] = {}
    for package in PACKAGES:
        for path in sources(package):
            for change in changes(path.relative_to(ROOT).as_posix(), path.read_bytes()):
                places.setdefault((package, change.operator), []).append(change)
    while len(found) < count:
        here = places.get((rng.choice(PACKAGES), rng.choice([*OPERATORS])), [])
        found += [change for change in rng.sample(here, min(len(here), 1)) if change not in found]
    return found


def package_of(change: Change) -> str:
    """Return the package that a change is in."""
    return next(p for p in (*PACKAGES, *CODEC) if change.path.startswith(f"{p}/"))


def users(change: Change, root: Path) -> list[str]:
    """List the files of tests that import the module of a change."""
    *package, module = Path(change.path).with_suffix("").parts
    names = ".".join([*package, module]), f"from {'.'.join(package)} import {module}"
    found = sorted(
        path for path in (root / "tests").glob("*/**/test_*.py") if any(map(path.read_text().count, names))
    )
    return [path.relative_to(root).as_posix() for path in found]


def stages(change: Change, root: Path) -> list[tuple[str, ...]]:
    """List the stages of tests, the nearest tests first."""
    package, path = package_of(change), Path(change.path)
    mirrored = Path("tests") / path.with_name(f"test_{path.name}").as_posix().removeprefix("dvc/")
    whole = f"tests/{package.removeprefix('dvc/')}"
    canaries, late = ([CANARIES], []) if package in CODEC else ([], [CANARIES])
    near = [[mirrored.as_posix()], users(change, root), canaries, [mirrored.parent.as_posix()]]
    found, before = [], list[str]()
    for stage in (*near, [whole], CONTRACTS, late):
        if new := [at for at in stage if at not in before and (root / at).exists()]:
            found.append((*new, *(f"--ignore={at}" for at in before)))
            before += new
    return found


def failed(tree: Path, tests: Sequence[str], limit_s: float) -> bool | None:
    """Return whether tests fail; None if they take too long."""
    options = ["-x", "-q", "-m", "not slow", "-p", "no:cacheprovider", "--timeout=60"]
    environment = child_environment() | {"PYTHONPATH": str(tree), "DVC_REGENERATE": "0"}
    with subprocess.Popen(
        python_module("pytest", *options, *tests),
        cwd=tree,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as process:
        try:
            return process.wait(limit_s) not in (0, 5)  # 5: nothing was collected
        except subprocess.TimeoutExpired:
            return None
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)


class Copies:
    """The tree as it is, and copies of it that share all files but one."""

    def __init__(self, folder: Path, limit_s: float) -> None:
        self._folder, self._warm, self._lock = folder, folder / "tree", Lock()
        self._limit_s = limit_s
        shutil.rmtree(self._warm, ignore_errors=True)
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
        tracked = [ROOT / name for name in listed.decode().split("\0") if name]
        for path in tracked:
            if path.exists():
                target = self._warm / path.relative_to(ROOT)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path, target)

    def warm(self, packages: Sequence[str]) -> None:
        """Compile the kernels that tests call; without a change they pass."""
        for package in packages:
            tests = f"tests/{package.removeprefix('dvc/')}"
            for at in (CANARIES, tests):
                if (self._warm / at).exists() and failed(self._warm, [at], 1800.0) is not False:
                    raise SystemExit(f"{at} fails without any change")

    def notices(self, change: Change) -> tuple[bool, float, str]:
        """Return whether tests notice a change, the time until then, and the tests."""
        started = time.monotonic()
        tree = self._folder / f"changed_{time.monotonic_ns()}"
        with self._lock:
            shutil.copytree(self._warm, tree, copy_function=os.link)
        try:
            target = tree / change.path
            source = target.read_bytes()
            target.unlink()  # the other name of the file stays as it is
            target.write_bytes(change.applied(source))
            for stage in stages(change, tree):
                left_s = self._limit_s - (time.monotonic() - started)
                if left_s > 0 and failed(tree, stage, left_s):
                    return True, time.monotonic() - started, stage[0]
            return False, time.monotonic() - started, ""
        finally:
            shutil.rmtree(tree, ignore_errors=True)


class Outcomes:
    """Outcomes of changes of the present code, in a file."""

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, Lock()
        digest = hashlib.sha256()
        for package in dict.fromkeys((*PACKAGES, *CODEC)):
            for source in sources(package):
                digest.update(source.read_bytes())
        kept = json.loads(path.read_text()) if path.exists() else {}
        code = digest.hexdigest()[:16]
        self._kept: dict[str, Any] = kept if kept.get("code") == code else {"code": code, "changes": {}}

    def of(self, change: Change) -> dict[str, Any] | None:
        """Return the outcome of a change, if known."""
        found: dict[str, Any] | None = self._kept["changes"].get("|".join(map(str, change)))
        return found

    def add(self, change: Change, noticed: bool, seconds: float, by: str) -> None:
        """Record an outcome."""
        with self._lock:
            found = {"noticed": noticed, "seconds": round(seconds, 1), "by": by}
            self._kept["changes"]["|".join(map(str, change))] = found
            self._path.write_text(json.dumps(self._kept, indent=1) + "\n")
        print(f"{'noticed ' if noticed else 'SURVIVED'} {seconds:6.1f} s  {shown(change)}  {by}", flush=True)


def shown(change: Change) -> str:
    """Return a line that describes a change."""
    line = (ROOT / change.path).read_text(encoding="utf-8").splitlines()[change.line - 1].strip()
    return f"{change.path}:{change.line} {change.operator}: {change.before!r} -> {change.after!r} in `{line}`"


def summary(kind: str, of: Sequence[Change], outcomes: Outcomes) -> Iterator[str]:
    """Return the number of noticed changes, and list the rest."""
    known = [(change, found) for change in of if (found := outcomes.of(change)) is not None]
    noticed = sum(found["noticed"] for _, found in known)
    yield f"{kind}: {noticed} of {len(known)} noticed"
    for change, found in known:
        if not found["noticed"]:
            yield f"  {shown(change)}"


def main(words: Sequence[str] | None = None) -> int:
    """Run the command, and return the exit status."""
    parser = argparse.ArgumentParser("python -m benchmarks.mutants", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/mutants"), help="folder of copies and results")
    parser.add_argument("--count", type=int, default=60, help="changes that are drawn; default: 60")
    parser.add_argument("--seed", type=int, default=30)
    parser.add_argument("--jobs", type=int, default=1, help="changes at a time")
    parser.add_argument("--limit", type=float, default=240.0, help="seconds for a change; default: 240")
    parser.add_argument("--cold", action="store_true", help="do not run the tests without a change first")
    arguments = parser.parse_args(words)
    arguments.out.mkdir(parents=True, exist_ok=True)
    named = [named_change(one, ROOT) for one in NAMED]
    sampled = drawn(arguments.count, arguments.seed)
    outcomes = Outcomes(arguments.out / "results.json")
    due = [one for one in (*named, *sampled) if outcomes.of(one) is None]
    copies = Copies(arguments.out.resolve(), arguments.limit)
    if due and not arguments.cold:
        copies.warm(sorted({package_of(change) for change in due}))

    def run(change: Change) -> None:
        outcomes.add(change, *copies.notices(change))

    with ThreadPoolExecutor(arguments.jobs) as pool:
        list(pool.map(run, due))
    print(*summary("named", named, outcomes), *summary("drawn", sampled, outcomes), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
