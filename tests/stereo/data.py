"""Camera arrays for tests: pairs with known surfaces, and real sets; and runs of the command."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dvc.geometry.camera_array import ArrayView, CameraArray, LatticePosition
from dvc.stereo.__main__ import main

REAL_SETS = Path(__file__).resolve().parents[2].parent / "shared" / "stereo"


def real_set(name: str) -> Path:
    """Return the folder of a real set; skip the test if it is missing."""
    folder = REAL_SETS / name
    if not folder.is_dir():
        pytest.skip(f"no folder ../shared/stereo/{name} beside the project")
    return folder


def pair_of_planes(
    height: int = 48, width: int = 72, near: int = 6, far: int = 2
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float64]]:
    """Return a left and a right view of a square before a background, and the disparity of the left one."""
    rng = np.random.default_rng(7)
    background = rng.integers(0, 256, (height, width + far, 3)).astype(np.uint8)
    square = rng.integers(0, 256, (height // 2, width // 3, 3)).astype(np.uint8)
    top, left = height // 4, width // 3
    views = []
    for camera in (0, 1):
        view = background[:, far * camera : far * camera + width].copy()
        at = left - near * camera
        view[top : top + square.shape[0], at : at + square.shape[1]] = square
        views.append(view)
    disparity = np.full((height, width), float(far))
    disparity[top : top + square.shape[0], left : left + square.shape[1]] = near
    return views[0], views[1], disparity


def array_of(
    *images: NDArray[np.uint8], places: Sequence[tuple[float, float]] = ((0.0, 0.0), (1.0, 0.0))
) -> CameraArray:
    """Return views at places, by default two in a row."""
    views = enumerate(zip(images, places, strict=True))
    return CameraArray(tuple(ArrayView(f"view{k}", image, LatticePosition(*at)) for k, (image, at) in views))


def run(*arguments: object) -> int:
    """Return the exit status of `dvc-stereo`."""
    try:
        return main([str(argument) for argument in arguments])
    except SystemExit as err:
        return int(err.code or 0)


def check_refused(capsys: pytest.CaptureFixture[str], message: str, *arguments: object) -> None:
    """Run the command, which must fail with one line of error."""
    capsys.readouterr()
    assert run(*arguments) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""
