"""*toy*: things on a floor before a wall, seen by two rows of two cameras; their axes are not parallel."""

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from sequences.cameras import look_at
from sequences.description import Description
from sequences.lighting import LightMaps, Weather
from sequences.meshes import Mesh, merge, patch
from sequences.props import column
from sequences.shapes import box, lathe
from sequences.textures import NUMBER

Floats = NDArray[np.float64]

POSITIONS = ((0, 0), (1, 0), (0, 1), (1, 1))
"""Places (m, n) of the cameras: m to the right, n downwards."""
STEP_RIGHT_M, STEP_DOWN_M = 0.24, 0.17
_UPPER_LEFT = np.array([-0.12, 0.0, 1.32])
_TURNS_DEG = ((0.8, -1.5, 1.2), (-0.6, 1.1, -0.8), (1.2, 0.7, -1.6), (-1.0, -0.9, 0.9))


def _pose(index: float, seed: int) -> Floats:
    """Return the camera of a place; all look roughly at the middle of the scene."""
    del seed
    m, n = POSITIONS[int(index)]
    eye = _UPPER_LEFT + np.array([m * STEP_RIGHT_M, 0.0, -n * STEP_DOWN_M])
    target = eye + np.array([0.05 - 0.12 * m, 4.0, -0.35 + 0.1 * n])
    return look_at(eye, target, _TURNS_DEG[int(index)])


def _geometry(rng: np.random.Generator, detail: float) -> Mesh:
    """Build the room; it needs neither chance nor detail."""
    del rng, detail
    room = [
        patch((-6, -1, 0), (12, 0, 0), (0, 9.0, 0), NUMBER["wood"], (1, 1, 1), 0.5),
        patch((-6, 6.0, 0), (12, 0.8, 0), (0, 0, 6), NUMBER["brick"], (1.1, 1.05, 1.0), 0.6),
    ]
    things = [
        box((-1.35, 3.3, 0.0), (-0.55, 3.9, 1.05), NUMBER["coffee"], (1.2, 1.2, 1.2), 0.4),
        box((-0.25, 2.55, 0.0), (0.15, 2.9, 0.72), NUMBER["rocket"], (1.2, 1.2, 1.2), 0.3, 0.4).turned(12.0),
        box((0.55, 4.4, 0.0), (1.45, 5.0, 1.55), NUMBER["ashlar"], (1, 1, 1), 0.4).turned(-6.0),
        box((-0.6, 5.0, 0.0), (0.3, 5.3, 1.9), NUMBER["tiles"], (1, 1, 1), 0.4),
        column((-0.35, 3.75, 0.0), 1.5, 0.13),
        _vase().moved((0.62, 2.75, 0.0)),
    ]
    return merge(room + things)


def _vase() -> Mesh:
    profile = [(0.10, 0.0), (0.20, 0.12), (0.24, 0.3), (0.20, 0.48), (0.10, 0.6), (0.09, 0.68), (0.13, 0.74)]
    return lathe([*profile, (0.02, 0.74)], (0, 0, 0), NUMBER["cobbles"], (1.6, 1.2, 0.8), 24)


DESCRIPTION = Description(
    name="toy",
    frame_rate=Fraction(1),
    num_frames=len(POSITIONS),
    field_of_view_deg=52.0,
    exposure=0.62,
    shows="boxes, a column and a vase before a brick wall",
    motion="none: four pictures of a planar array of two by two cameras, not rectified",
    purpose="stereo from camera arrays: exact depth, axes that are not parallel, cells that are not square",
    motion_px=(0.0, 0.0, 0.0),
    pose=_pose,
    geometry=_geometry,
    weather=Weather(azimuth_deg=-35.0, elevation_deg=62.0),
    light=LightMaps((0.0, 3.5, 1.0), 6.0, 1536, directions=32),
)
