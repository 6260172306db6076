"""Whether the surfaces of two cameras agree where both see a point."""

from functools import partial
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.stereo.runs import reconstructed
from dvc.stereo.surfaces.surface import Reconstruction
from dvc.stereo.thesis.real_sets import PAIRS, TSUKUBA, RealSet

AREA = "stereo"
LEAST_PERCENT = 97.0
CASES = {"tsukuba": (TSUKUBA, 5), "cones": (PAIRS["cones"], 9)}


def agreement(found: Reconstruction, source: int, target: int) -> tuple[int, int]:
    """Count points of one camera's surface that another one sees, and those that it agrees on."""
    surface = found.surfaces[source]
    start, end = found.array[source].position, found.array[target].position
    height, width = found.array.shape
    y, x = np.nonzero(~surface.occluded)
    disparity: NDArray[np.float64] = surface.disparity[y, x].astype(np.float64)
    to_x = np.rint(x - (end.m - start.m) * disparity).astype(np.int64)
    to_y = np.rint(y - (end.n - start.n) * disparity).astype(np.int64)
    inside = (to_x >= 0) & (to_x < width) & (to_y >= 0) & (to_y < height)
    difference = disparity[inside] - found.surfaces[target].disparity[to_y[inside], to_x[inside]]
    limit = found.labels.step * 1.001
    return int(np.sum(np.abs(difference) <= limit)), int(np.sum(difference >= -limit))


def consistency(setting: Setting, clip: str, name: str) -> Measured:
    """Look every point of a camera's surface up in all other cameras."""
    del setting, clip
    one, num_cameras = CASES[name]
    found = reconstructed(one, num_cameras)
    counts = np.array([agreement(found, *pair) for pair in permutations(range(num_cameras), 2)])
    percent = 100.0 * float(counts[:, 0].sum() / counts[:, 1].sum())
    worst = 100.0 * float((counts[:, 0] / counts[:, 1]).min())
    text = f"{percent:.2f} % (worst pair of cameras {worst:.2f} %)"
    return Measured(text, percent >= LEAST_PERCENT, {"percent": percent, "worst_percent": worst})


def _title(name: str, case: tuple[RealSet, int]) -> str:
    return (
        f"points of a surface that other cameras see and agree on within a label, {name}, {case[1]} cameras"
    )


FIGURES = tuple(
    Figure(
        AREA,
        f"consistency-{name}",
        _title(name, case),
        f"≥ {LEAST_PERCENT:g} %",
        partial(consistency, name=name),
        slow=case[1] > 5,
    )
    for name, case in CASES.items()
)
"""The figures of this module."""
