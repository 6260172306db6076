"""Kernels compiled beforehand: the list holds what programs call, which then compile nothing."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from dvc._jit import RUNS_PORTABLE
from dvc.compile_kernels import KERNELS, Kernel, listed
from dvc.dibr.names import OWN_NAMES
from dvc.picture_files import write_png
from tests.clips import moving_texture
from tests.golden_streams import GOLDEN, Golden, source
from tests.recorder import recording

ROOT = Path(__file__).resolve().parents[1]
RUN = """
import importlib, json, sys
for program, *arguments in json.load(sys.stdin):
    assert importlib.import_module(f"{program}.__main__").main(arguments) == 0
"""
OTHER_MAKE = {
    "NUMBA_CPU_NAME": "haswell",
    "NUMBA_CPU_FEATURES": "+avx,+avx2,+bmi,+bmi2,+f16c,+fma,+lzcnt,+movbe,+popcnt,+sse4.2",
}


def run(commands: Sequence[Sequence[object]], environment: dict[str, str]) -> None:
    """Run programs one after the other, in one process but for those that they start."""
    lines = json.dumps([[*map(str, command)] for command in commands])
    subprocess.run([sys.executable, "-c", RUN], input=lines, env=environment, cwd=ROOT, text=True, check=True)


def coding(golden: Golden, folder: Path) -> list[list[object]]:
    """Return how a frozen stream is made, and decoded."""
    (folder / golden.name).mkdir()
    made = folder / golden.name / "made.dvc"
    encoding = ["encoder", source(golden, folder / golden.name), made, *golden.coding.split(), "--quiet"]
    return [
        *([] if golden.is_live else [encoding]),
        *(["decoder", golden.path(form), folder / "video.y4m", "--quiet"] for form in golden.forms[:1]),
    ]


def coding_a_scene(folder: Path) -> list[list[object]]:
    """Return how a rendered clip is made, coded and decoded."""
    video, stream = folder / "street.mkv", folder / "street.dvc"
    return [
        ["sequences", "render", "street", "--size", "176x144", "--frames", "9", "--out", video],
        ["encoder", video, stream, "--qp", "30", "--quiet"],
        ["decoder", stream, folder / "video.y4m", "--quiet"],
    ]


def matching_and_coding_pictures(folder: Path) -> list[list[object]]:
    """Return what reconstructs views, codes them in all ways, and renders others."""
    views, left = [folder / f"{name}.png" for name in ("left", "right")], moving_texture(1, 48, 64)[0].luma
    right = np.roll(left, -1, axis=1)
    right[12:36, 20:44] = np.roll(left, -5, axis=1)[12:36, 20:44]
    write_png(views[0], left)
    write_png(views[1], right)
    tries = {
        "surfaces": ["0:6"],
        "finer": ["0:6:0.5", "--lattice", "0,0", "1.03,0.37", "--cost", "squared", "--sub-pixel"],
        "paths": ["0:6", "--inference", "semi-global", "--occlusion", "implicit"],
        "open": ["0:6", "--occlusion", "none"],
    }
    surfaces = [
        ["dvc.stereo", "reconstruct", *views, "--out", folder / name, "--quiet", "--disparities", *words]
        for name, words in tries.items()
    ]
    depth = folder / "surfaces" / "disparity-left.pfm"
    ways: dict[str, tuple[str, list[Path], list[str]]] = {
        **{way: ("encode", views, ["--disparities", "0:6", "--disparity", way]) for way in OWN_NAMES},
        "fine": ("encode", views, ["--disparities", "0:6:0.5", "--quality-layers", "2"]),
        **{edges: ("encode-depth", [depth], ["--edges", edges]) for edges in ("auto", "canny")},
        "standard": ("encode-depth", [depth], ["--transform", "standard", "--wavelet", "5/3"]),
        "image": ("encode-image", views[:1], ["--depth", str(depth)]),
        "pieces": ("encode-layers", [folder / "layers"], ["--keep", "all"]),
        "sprites": ("encode-layers", [folder / "pieces"], []),
    }
    streams = [
        ["dvc.dibr", command, *inputs, folder / f"{name}.dibr", *words, "--bpp", "1", "--quiet"]
        for name, (command, inputs, words) in ways.items()
    ]
    rendered = [
        ["dvc.dibr", "render", folder / f"{name}.dibr", "--view", "0.5,0", "--out", folder / f"{name}.png"]
        for name, (command, _, _) in ways.items()
        if command != "encode-depth"
    ]
    return [
        *surfaces,
        ["dvc.stereo", "layers", folder / "surfaces", "--out", folder / "layers", "--quiet"],
        ["dvc.stereo", "sprites", folder / "layers", "--out", folder / "pieces", "--quiet"],
        *streams,
        *rendered,
        *(
            ["dvc.dibr", "decode", folder / f"{name}.dibr", "--out", folder / name]
            for name in ("auto", "image")
        ),
    ]


def test_list_holds_what_coders_of_pictures_call(tmp_path: Path) -> None:
    """Views, layers and maps, in all ways that commands have."""
    with recording(tmp_path) as environment:
        run(matching_and_coding_pictures(tmp_path), environment)


@pytest.mark.parametrize("part", range(2))
def test_list_holds_what_codecs_call(part: int, tmp_path: Path) -> None:
    """Every kernel that Python calls is listed with its types; `DVC_REGENERATE=1` adds what is missing.

    So it is for what the commands of the documents call: see `tests/test_readme.py`.
    """
    with recording(tmp_path) as environment:
        run([command for golden in GOLDEN[part::2] for command in coding(golden, tmp_path)], environment)


def test_list_is_in_order() -> None:
    """Lines are kernels, sorted, each once."""
    lines = KERNELS.read_text(encoding="utf-8").splitlines()
    assert lines == sorted(set(lines))
    assert listed()[0] == Kernel(*lines[0].split(" ", 2))


def test_nothing_is_compiled_at_run_time(tmp_path: Path) -> None:
    """After `dvc-compile` programs keep no code of their own, on a processor of another make, too.

    What they call is listed.
    """
    subprocess.run([sys.executable, "-m", "dvc.compile_kernels"], cwd=ROOT, check=True)
    elsewhere = {"NUMBA_CACHE_DIR": str(tmp_path / "compiled"), "HOME": str(tmp_path)}
    with recording(tmp_path) as environment:
        run(coding_a_scene(tmp_path), environment | elsewhere | (OTHER_MAKE if RUNS_PORTABLE else {}))
    assert [path.name for path in tmp_path.rglob("*.nbi")] == []


@pytest.mark.parametrize(
    ("environment", "served"),
    [
        ({}, True),
        pytest.param(OTHER_MAKE, True, marks=pytest.mark.skipif(not RUNS_PORTABLE, reason="needs AVX2")),
        ({"NUMBA_CPU_NAME": "nehalem", "NUMBA_CPU_FEATURES": "+sse4.2"}, False),
        ({"NUMBA_BOUNDSCHECK": "1"}, False),
        ({"NUMBA": "another version"}, False),
    ],
    ids=["here", "other-make", "without-avx2", "bounds", "other-numba"],
)
def test_code_serves_where_it_runs(environment: dict[str, str], served: bool, tmp_path: Path) -> None:
    """Elsewhere, where bounds are checked and by another numba a kernel is compiled once, to the same."""
    Kernel("dvc.wynerziv._kernels", "logarithm", "(float64,)").compile()
    code = (
        "import numba, os; numba.__version__ = os.environ.get('NUMBA', numba.__version__)\n"
        "from dvc.wynerziv._kernels import logarithm as f; print(f(1.5), len(f.stats.cache_hits))"
    )
    command = [sys.executable, "-c", code]
    told = []
    for _ in range(2):
        kept = os.environ | environment | {"NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_DISABLE_JIT": "0"}
        run = subprocess.run(command, env=kept, cwd=ROOT, capture_output=True, text=True, check=True)
        told.append(run.stdout.split())
    assert {value for value, _ in told} == {"0.4054651081081644"}
    assert [hits for _, hits in told] == [str(int(served)), "1"]
    assert any(tmp_path.rglob("*.nbi")) is not served
