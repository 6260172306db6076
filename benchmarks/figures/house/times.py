"""Time before and after: decoding, a first run without compiled kernels on disk, and the tests."""

import json
import statistics
import tempfile
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from benchmarks.figures.harness import Figure, Measured, Setting, Usage, clip_source
from benchmarks.figures.house.revisions import BASE, PROGRAMS, TREE, base_tree, run_in

AREA = "house"
CLIPS = ("street", "box")
FRAMES = 17
COLD_FRAMES = 9


def ratio(run: Callable[[Path], Usage], base: Path, repetitions: int, limit: float, judged: str) -> Measured:
    """Run both revisions in turn, the old one first and last."""
    used: dict[Path, list[Usage]] = {base: [run(base)], TREE: []}
    for _ in range(repetitions):
        used[TREE].append(run(TREE))
        used[base].append(run(base))
    now_s, before_s = (
        statistics.median(getattr(usage, judged) for usage in used[tree]) for tree in (TREE, base)
    )
    found = now_s / before_s
    values = {"ratio": found, "now": [*map(asdict, used[TREE])], "before": [*map(asdict, used[base])]}
    return Measured(f"{found:.2f} ({before_s:.1f} → {now_s:.1f} s)", found <= limit, values)


def _encode(tree: Path, clip: str, stream: Path, *options: object) -> None:
    video = clip_source(clip).path.absolute()
    run_in(tree, "encoder", [video, stream, "--codec", "3d-te", "--luma-only", "--quiet", *options])


def _decode(folder: Path, environment: dict[str, str], tree: Path) -> Usage:
    stream = folder / ("now.dvc" if tree == TREE else "before.dvc")
    outputs = [folder / "v.y4m", "--json", folder / "report.json"]
    return run_in(tree, "decoder", [stream, *outputs, "--jobs", 1, "--quiet"], environment)


def _with_scene(folder: Path, measured: Measured) -> Measured:
    """Say how many frames the scene served: where it did not, its kernels were not timed."""
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    methods = [frame["side_information"] for frame in report["per_frame"] if frame["type"] == "wz"]
    served = len(methods) - methods.count("mci")
    return replace(measured, note=f"the scene served {served} of {len(methods)} frames")


def decode_ratio(setting: Setting, clip: str, quantiser: int) -> Measured:
    """Decode a sequence, each revision what it encoded itself, with compiled kernels on disk."""
    with base_tree() as base, tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        run = partial(_decode, folder, {})
        for tree, name in ((base, "before.dvc"), (TREE, "now.dvc")):
            frames = setting.choose(FRAMES, 3)
            _encode(tree, clip, folder / name, "--wz-q", quantiser, "--frames", frames)
            run(tree)
        return _with_scene(folder, ratio(run, base, setting.choose(2, 1), 1.0, "cpu_s"))


def first_run_ratio(setting: Setting, clip: str) -> Measured:
    """Decode a few small frames without a compiled kernel on disk."""
    with base_tree() as base, tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        video = folder / "v.mkv"
        size, count = ["--size", "176x144"], ["--frames", setting.choose(COLD_FRAMES, 3)]
        run_in(TREE, "sequences", ["render", clip, *size, *count, "--out", video])

        def run(tree: Path) -> Usage:
            with tempfile.TemporaryDirectory() as kernels:
                return _decode(folder, {"NUMBA_CACHE_DIR": kernels}, tree)

        for tree, name in ((base, "before.dvc"), (TREE, "now.dvc")):
            run_in(tree, "encoder", [video, folder / name, "--codec", "3d-te", "--wz-q", 4, "--quiet"])
        return _with_scene(folder, ratio(run, base, 1, 0.5, "wall_s"))


def tests_ratio(setting: Setting, _clip: str) -> Measured:
    """Run the tests of both revisions as `make test` does, each without a compiled kernel on disk."""
    with base_tree() as base:

        def run(tree: Path) -> Usage:
            with tempfile.TemporaryDirectory() as kernels:
                chosen = ["tests/test_bits.py"] if setting.quick else []
                arguments = ["-q", "-m", "not slow", "-n", 2, *chosen]
                return run_in(tree, "pytest", arguments, {"NUMBA_CACHE_DIR": kernels})

        return ratio(run, base, 1, 1.0, "wall_s")


_SETTING = "3d-te, 17 CIF frames, processor time, now over"
FIGURES = (
    *(
        Figure(
            AREA,
            f"decode-time-q{quantiser}",
            f"decoding at Q{quantiser}, {_SETTING} {BASE[:7]}",
            "≤ 1.0",
            partial(decode_ratio, quantiser=quantiser),
            CLIPS,
            slow=True,
        )
        for quantiser in (4, 8)
    ),
    Figure(
        AREA,
        "first-run-time",
        f"first decoding, kernels still to be compiled, 3d-te, 9 frames, 176x144, Q4, now over {BASE[:7]}",
        "≤ 0.5",
        first_run_ratio,
        ("street",),
        slow=True,
    ),
    Figure(
        AREA,
        "tests-time",
        f"`make test`, kernels still to be compiled, now over {BASE[:7]}",
        "≤ 1.0",
        tests_ratio,
        on_request=True,
        programs=PROGRAMS,
    ),
)
"""Figures of this module."""
