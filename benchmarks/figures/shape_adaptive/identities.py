"""Perfect reconstruction of the shape-adaptive transform with random edges."""

import numpy as np

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.shape_adaptive.depth import AREA
from dvc.dibr.wavelets import shape_adaptive
from dvc.dibr.wavelets.edge_maps import EdgeMaps
from dvc.dibr.wavelets.lifting import WAVELETS

NUM_PLANES = 20
NUM_LEVELS = 5
MOST_ERROR = 1e-9


def reconstruction(setting: Setting, clip: str) -> Measured:
    """Transform random planes of random sizes with random edges, few and many, and back."""
    del clip
    rng = np.random.default_rng(4)
    orders = range(shape_adaptive.MAX_ORDER + 1)
    errors = {f"{name} order {order}": 0.0 for name in WAVELETS for order in orders}
    count = setting.choose(NUM_PLANES, 2)
    for number in range(count):
        shape = (int(rng.integers(1, 130)), int(rng.integers(1, 130)))
        plane = rng.uniform(0.0, 255.0, shape)
        density = (number + 1) / count
        below, right = (np.asarray(rng.random(shape) < density, np.uint8) for _ in range(2))
        below[-1], right[:, -1] = 0, 0
        edges = EdgeMaps(below, right)
        for name, wavelet in WAVELETS.items():
            for order in orders:
                pyramid = shape_adaptive.analyse(plane, edges, NUM_LEVELS, order, wavelet)
                found = shape_adaptive.synthesise(pyramid, edges, order, wavelet)
                key = f"{name} order {order}"
                errors[key] = max(errors[key], float(np.abs(found - plane).max()))
    largest = max(errors.values())
    note = f"{count} planes of up to 129 samples a side, edges between all of their samples at most"
    return Measured(f"{largest:.1e}", largest <= MOST_ERROR, dict(errors), note)


FIGURES = (
    Figure(
        AREA,
        "reconstruction",
        f"largest error of the inverse, random edges, orders 0 to 3, 9/7 and 5/3, {NUM_LEVELS} levels",
        f"≤ {MOST_ERROR:g}",
        reconstruction,
    ),
)
"""The figures of this module."""
