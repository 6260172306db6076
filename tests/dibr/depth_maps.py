"""Depth maps of which everything is known."""

import numpy as np


def two_discs(height=96, width=120):
    """Return a slanted background with two discs in front of it: (H, W), float64."""
    y, x = np.mgrid[:height, :width].astype(float)
    depth = 10.0 + 0.05 * x + 0.02 * y
    for row, column, radius, level in ((40, 45, 25, 30.0), (60, 80, 18, 42.0)):
        inside = np.hypot(y - row, x - column) < radius
        depth[inside] = level - 0.03 * x[inside]
    return depth


def texture(height=96, width=120, seed=0):
    """Return a smooth random picture: (H, W), uint8."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    levels = sum(
        rng.uniform(10, 30) * np.cos(rng.uniform(-0.5, 0.5) * x + rng.uniform(-0.5, 0.5) * y + k)
        for k in range(6)
    )
    return np.clip(128 + levels, 0, 255).astype(np.uint8)
