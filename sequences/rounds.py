"""*rounds*: the stairway from a closed path: two rounds, the second a hand's breadth beside the first."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sequences import stairway
from sequences.cameras import look_at, tremor

Floats = NDArray[np.float64]

ROUND = 120
"""Frames of a round."""
BESIDE_M = 0.06
"""How far the second round is beside the first, at most."""


def _pose(index: float, seed: int) -> Floats:
    """An ellipse on the ground, the gaze turning to the left and right once a round."""
    time_s, angle = index / 30, 2.0 * math.pi * index / ROUND
    beside = BESIDE_M * math.sin(0.5 * angle)
    x = -0.3 + (1.0 + beside) * math.cos(angle) + 0.006 * tremor(time_s, seed, 1.0, 2.5)
    y = -4.6 + (0.5 + beside) * math.sin(angle)
    z = 1.72 + beside + 0.006 * tremor(time_s, seed + 2, 1.5, 3.0)
    tilt = 0.14 * tremor(time_s, seed + 3, 2.0, 5.5)
    pan = 16.0 * math.sin(angle) + 0.12 * tremor(time_s, seed + 5, 2.0, 5.5)
    return look_at((x, y, z), (x + 0.25, y + 10.0, z + 0.75), (tilt, pan, 0.0))


DESCRIPTION = replace(
    stairway.DESCRIPTION,
    name="rounds",
    num_frames=2 * ROUND,
    motion="two rounds on a closed path, turning to the left and right, with the tremor of a hand",
    purpose="what comes back: the second round shows what the first has shown",
    motion_px=(4.09, 0.79, 6.88),
    pose=_pose,
)
