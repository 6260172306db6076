"""*statue*: half round a statue on its pedestal, which hides and uncovers the square behind it."""

import math
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from sequences.architecture import facade
from sequences.cameras import look_at, there_and_back, tremor
from sequences.description import Description
from sequences.foliage import clump, tree
from sequences.lighting import LightMaps, Weather
from sequences.meshes import Mesh, merge, patch
from sequences.openings import PAINTS, Style
from sequences.props import bench, bollard, column, lamp, planter
from sequences.sculpture import figure
from sequences.shapes import box, extrude, lathe, square_moulding
from sequences.textures import NUMBER

Floats = NDArray[np.float64]

RADIUS_M, TURN_DEG = 5.6, 0.6
PEDESTAL_M = 1.55


def _pose(index: float, seed: int) -> Floats:
    """An arc round the statue and a light tremor."""
    time_s = index / 25
    angle = math.radians(-22.0 + TURN_DEG * there_and_back(index, 74.0, 5.0))
    radius = RADIUS_M + 0.05 * tremor(time_s, seed, 0.2, 0.7)
    z = 1.68 + 0.012 * tremor(time_s, seed + 1, 0.8, 2.0)
    turn = [0.10 * tremor(time_s, seed + 2 + k, 0.8, 3.5) for k in range(2)]
    eye = (radius * math.sin(angle), -radius * math.cos(angle), z)
    return look_at(eye, (0.0, 0.0, 2.02), (turn[0], turn[1], 0.08 * tremor(time_s, seed + 4, 0.5, 2.0)))


def _geometry(rng: np.random.Generator, detail: float) -> Mesh:
    """Build the square; `detail` is the share of the leaves and the fineness of the statue."""
    stone = figure(0.016 if detail > 0.3 else 0.03).moved((0, 0, PEDESTAL_M))
    return merge(
        [stone, _pedestal(), _ground(), _houses(rng), _portico(), _furniture(), _greenery(rng, detail)]
    )


def _pedestal() -> Mesh:
    tint, parts = (1.0, 0.97, 0.91), []
    for size, bottom, top in (
        (1.5, 0.0, 0.16),
        (1.3, 0.16, 0.3),
        (0.98, 0.42, 1.34),
        (0.9, 1.46, PEDESTAL_M),
    ):
        half = size / 2
        material = NUMBER["marble"] if bottom > 0.2 else NUMBER["stone"]
        parts.append(box((-half, -half, bottom), (half, half, top), material, tint, 0.12, uv_at=3 * bottom))
    base = [(0.0, 0.12), (0.06, 0.09), (0.05, 0.06), (0.13, 0.03), (0.13, 0.0)]
    crown = [(-0.1, 0.13), (0.13, 0.13), (0.14, 0.12), (0.14, 0.08), (0.06, 0.05), (0.05, 0.02), (0.0, 0.0)]
    parts += [
        square_moulding(profile, 0.49, NUMBER["marble"], tint).moved((0, 0, z))
        for profile, z in ((base, 0.3), (crown, 1.34))
    ]
    parts.append(box((-0.32, -0.515, 0.62), (0.32, -0.48, 1.12), NUMBER["stone"], (0.42, 0.40, 0.34), 0.2))
    for row in range(4):
        for k in range(7 - row % 2):
            low = (-0.25 + 0.07 * k + 0.03 * (row % 2), -0.522, 1.0 - 0.1 * row)
            parts.append(
                box(low, (low[0] + 0.045, -0.51, low[2] + 0.05), NUMBER["paint"], (1.1, 0.95, 0.6), 0.2)
            )
    return merge(parts)


def _ground() -> Mesh:
    parts = [patch((-40, -14, 0), (80, 0, 0), (0, 34, 0), NUMBER["cobbles"], (1, 1, 1), 0.7)]
    steps = [(2.35, 0.0), (2.35, 0.10), (2.32, 0.12), (1.75, 0.12), (1.75, 0.22), (1.72, 0.24), (0.2, 0.24)]
    disc = lathe(steps, (0, 0, -0.10), NUMBER["stone"], (0.95, 0.93, 0.9), 64)
    parts.append(disc)
    for y in (6.2, 6.9):
        parts.append(
            patch((-30, y, 0.006), (60, 0, 0), (0, 0.35, 0), NUMBER["paving"], (1.15, 1.1, 1.02), 0.6)
        )
    parts.append(patch((-30, 9.0, 0.012), (60, 0, 0), (0, 2.3, 0), NUMBER["paving"], (1.0, 0.98, 0.95), 0.6))
    return merge(parts)


def _houses(rng: np.random.Generator) -> Mesh:
    parts = []
    tints = [
        (0.97, 0.82, 0.60),
        (0.95, 0.90, 0.82),
        (0.86, 0.60, 0.48),
        (0.98, 0.88, 0.70),
        (0.74, 0.79, 0.80),
    ]
    x = -31.0
    for k in range(7):
        width = float(rng.uniform(7.5, 10.0))
        style = Style(
            ("plaster", "brick", "plaster", "ashlar")[k % 4],
            tints[k % 5] if k % 4 in (0, 2) else (1.0, 1.0, 1.0),
            paint=PAINTS[k % 4],
            ground=("shop", "door", "plain")[k % 3],
            shutters=k % 3 == 0,
        )
        parts.append(facade(rng, width, int(rng.integers(3, 5)), style).moved((x, 13.6 + 0.15 * (k % 2), 0)))
        x += width
    for side, turn in ((-1, 90.0), (1, -90.0)):
        for k in range(3):
            style = Style(
                ("ashlar", "plaster", "brick")[k], (1.0, 0.93, 0.84), paint=PAINTS[k], ground="door"
            )
            house = facade(rng, 9.0, 3 + k % 2, style)
            parts.append(house.turned(turn).moved((side * 24.0, -8.0 + 9.0 * (k + (side > 0)), 0)))
    return merge(parts)


def _portico() -> Mesh:
    stone, tint = NUMBER["ashlar"], (1.02, 0.99, 0.93)
    parts = [box((-6.0, 10.8, 0.0), (5.2, 13.6, 0.36), NUMBER["stone"], (0.95, 0.93, 0.9), 0.5)]
    for k in range(6):
        parts.append(column((-5.4 + 2.0 * k, 11.4, 0.36), 4.2, 0.27, tint))
    parts.append(box((-6.0, 10.9, 4.56), (5.2, 13.6, 5.1), stone, tint, 0.5))
    cornice = [(0.05, 0.3), (0.4, 0.28), (0.4, 0.16), (0.2, 0.08), (0.1, 0.0), (0.0, 0.0)]
    parts.append(extrude(cornice, (-6.0, 10.9, 5.0), (5.2, 10.9, 5.0), NUMBER["stone"], tint))
    parts.append(extrude(cornice, (5.2, 10.9, 5.0), (5.2, 13.6, 5.0), NUMBER["stone"], tint))
    parts.append(patch((-6.0, 10.9, 5.3), (11.2, 0, 0), (0, 2.7, 1.0), NUMBER["tiles"], (1, 1, 1), 0.6))
    return merge(parts)


def _furniture() -> Mesh:
    parts = [bench((x, 8.6, 0)) for x in (-9.5, -3.0, 3.2, 9.6)]
    parts += [lamp((x, 7.9, 0), 0.6, 3.8) for x in (-12.0, -5.6, 6.4, 13.5)]
    parts += [bollard((x, 5.3, 0)) for x in np.arange(-13.5, 14.0, 1.5)]
    for x in (-8.0, 1.0, 8.0):
        parts.append(planter((x - 0.9, 6.0, 0), (x + 0.9, 6.7, 0.5)))
    for angle in np.radians(np.arange(15.0, 375.0, 30.0)):
        parts.append(bollard((3.1 * math.sin(angle), 3.1 * math.cos(angle), 0)))
    return merge(parts)


def _greenery(rng: np.random.Generator, detail: float) -> Mesh:
    parts = []
    for x, y, high in (
        (-10.5, 9.6, 6.6),
        (-14.0, 6.5, 7.2),
        (9.4, 9.8, 6.4),
        (13.0, 7.0, 7.4),
        (18.0, 9.0, 7.0),
    ):
        colour = (0.20, 0.38, 0.09) if x < 0 else (0.25, 0.39, 0.10)
        parts.append(tree(rng, (x, y, 0), high, 1.9, int(6500 * detail), 0.16, colour))
    for x in (-8.0, 1.0, 8.0):
        for k in range(3):
            centre = (x - 0.55 + 0.55 * k, 6.35, 0.68)
            colour = (0.17, 0.35, 0.09) if k % 2 else (0.24, 0.38, 0.10)
            parts.append(clump(rng, centre, (0.34, 0.3, 0.28), int(500 * detail) + 10, 0.08, colour))
    return merge(parts)


DESCRIPTION = Description(
    name="statue",
    frame_rate=Fraction(25),
    num_frames=50,
    field_of_view_deg=50.0,
    exposure=0.56,
    shows="a robed figure on a pedestal in a square with a portico, houses and trees",
    motion="sideways on an arc round the statue, with a light tremor",
    purpose="large occlusions, a smooth curved surface, background that moves faster than the subject",
    motion_px=(2.29, 1.66, 2.92),
    pose=_pose,
    geometry=_geometry,
    weather=Weather(azimuth_deg=-118.0, elevation_deg=44.0),
    light=LightMaps((0.0, 7.0, 2.0), 21.0, 2048, directions=36),
)
