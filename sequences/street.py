"""*street*: forward along a street of town houses, the epipole inside the image."""

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
from sequences.props import bollard, car, lamp, planter, sign
from sequences.shapes import box, extrude, lathe
from sequences.textures import NUMBER

Floats = NDArray[np.float64]

SPEED_M = 0.17
KERB_M, FRONT_M, NEAR_Y, FAR_Y = 3.4, 5.6, -6.0, 92.0


def _pose(index: float, seed: int) -> Floats:
    """A smooth ride with a slow sway."""
    time_s = index / 30
    y = SPEED_M * there_and_back(index, 240.0, 12.0)
    x = 0.55 + 0.10 * tremor(time_s, seed, 0.1, 0.4)
    z = 1.62 + 0.014 * tremor(time_s, seed + 1, 0.5, 1.4)
    turn = (0.10 * tremor(time_s, seed + 2, 0.4, 1.2), 0.25 * tremor(time_s, seed + 3, 0.2, 0.6), 0.0)
    return look_at((x, y, z), (x - 1.5, y + 30.0, z + 0.9), turn)


def _geometry(rng: np.random.Generator, detail: float) -> Mesh:
    """Build the street; `detail` is the share of the leaves."""
    return merge(
        [_ground(rng), _houses(rng), _furniture(rng), _greenery(rng, detail), _background(rng, detail)]
    )


def _ground(rng: np.random.Generator) -> Mesh:
    length = FAR_Y - NEAR_Y
    road = patch((-KERB_M, NEAR_Y, 0), (2 * KERB_M, 0, 0), (0, length, 0), NUMBER["asphalt"], (1, 1, 1), 0.5)
    x = road.points[:, 0]
    tracks = np.exp(-(((x[:, None] - [-2.2, -0.8, 0.8, 2.2]) / 0.35) ** 2)).sum(axis=1)
    parts = [road.tinted((1.08 - 0.2 * tracks - 0.25 * np.exp((np.abs(x) - KERB_M) / 0.25))[:, None])]
    kerb = [(-0.16, 0.13), (0.0, 0.13), (0.03, 0.10), (0.04, 0.0)]
    parts.append(
        extrude(kerb, (KERB_M, FAR_Y, 0), (KERB_M, NEAR_Y, 0), NUMBER["stone"], (1.05, 1.03, 1.0), 0.9)
    )
    parts.append(
        extrude(kerb, (-KERB_M, NEAR_Y, 0), (-KERB_M, FAR_Y, 0), NUMBER["stone"], (1.05, 1.03, 1.0), 0.9)
    )
    side = FRONT_M - KERB_M
    for left in (KERB_M + 0.14, -FRONT_M - 0.1):
        origin, across, up = (left, NEAR_Y, 0.13), (side - 0.04, 0, 0), (0, length, 0)
        parts.append(patch(origin, across, up, NUMBER["paving"], (1.0, 0.99, 0.97), 0.45))
    for y in np.arange(NEAR_Y, FAR_Y - 3, 5.0):
        dash = patch((-0.06, y, 0.004), (0.12, 0, 0), (0, 2.4, 0), NUMBER["paint"], (1.25, 1.25, 1.2), 0.5)
        parts.append(dash.tinted(rng.uniform(0.65, 1.0, (len(dash.points), 1))))
    for left in np.arange(-KERB_M + 0.4, KERB_M - 0.5, 1.0):
        bar = patch((left, 26.0, 0.004), (0.5, 0, 0), (0, 3.0, 0), NUMBER["paint"], (1.25, 1.25, 1.2), 0.4)
        parts.append(bar.tinted(rng.uniform(0.6, 1.0, (len(bar.points), 1))))
    for place in ((0.9, 7.0), (-1.3, 15.0), (1.4, 23.0), (-0.7, 38.0)):
        disc = [(0.34, 0.0), (0.34, 0.006), (0.3, 0.007), (0.27, 0.004), (0.001, 0.005)]
        parts.append(lathe(disc, (*place, 0), NUMBER["paint"], (0.14, 0.13, 0.12), 20))
    for _ in range(9):
        at, size = rng.uniform((-2.6, 2.0), (1.6, 50.0)), rng.uniform(0.7, 2.0, 2)
        sides = (size[0], 0, 0), (0, 2 * size[1], 0)
        repair = patch((*at, 0.002), *sides, NUMBER["asphalt"], (1, 1, 1), 0.5, at)
        parts.append(repair.tinted(rng.choice([0.6, 0.72, 1.3])))
    return merge(parts)


def _houses(rng: np.random.Generator) -> Mesh:
    tints = [
        (0.98, 0.86, 0.66),
        (0.95, 0.92, 0.86),
        (0.84, 0.62, 0.50),
        (0.72, 0.78, 0.80),
        (0.97, 0.80, 0.60),
    ]
    walls = ["plaster", "brick", "plaster", "ashlar", "plaster", "brick"]
    parts = []
    for side in (-1, 1):
        y, k = NEAR_Y - 2.0, int(rng.integers(5))
        while y < FAR_Y:
            width, floors = rng.uniform(6.5, 10.5), int(rng.integers(3, 5))
            wall = walls[k % 6]
            tint = tints[(k + side) % 5] if wall == "plaster" else (1.0, 1.0, 1.0)
            paint = PAINTS[int(rng.integers(len(PAINTS)))]
            ground = ("shop", "door", "shop", "door", "door")[k % 5]
            style = Style(wall, tint, paint=paint, ground=ground, shutters=bool(rng.random() < 0.4))
            house = facade(rng, width, floors, style)
            front = FRONT_M + rng.uniform(0.0, 0.18)
            turn, start = (90.0, y) if side < 0 else (-90.0, y + width)
            parts.append(house.turned(turn).moved((side * front, start, 0.12)))
            y, k = y + width, k + 1
    return merge(parts)


def _furniture(rng: np.random.Generator) -> Mesh:
    parts = []
    colours = [
        (0.30, 0.03, 0.03),
        (0.62, 0.63, 0.64),
        (0.04, 0.08, 0.22),
        (0.75, 0.74, 0.7),
        (0.05, 0.055, 0.06),
    ]
    colours += [(0.10, 0.20, 0.13), (0.42, 0.36, 0.25)]
    for k, y in enumerate((11.0, 16.6, 22.0, 35.5, 41.0, 52.0, 58.0, 70.0)):
        parts.append(
            car(colours[k % 7]).turned(180.0).turned(rng.uniform(-1.5, 1.5)).moved((2.45, y, 0)).turned(0)
        )
    for k, y in enumerate((8.0, 13.4, 19.5, 33.0, 44.0, 49.5, 62.0)):
        parts.append(car(colours[(k + 3) % 7]).turned(rng.uniform(-1.5, 1.5)).moved((-2.45, y, 0)))
    for y in (9.5, 25.0, 40.5, 56.0, 72.0):
        parts.append(lamp((KERB_M + 0.35, y, 0.13), -1.1))
        parts.append(lamp((-KERB_M - 0.35, y + 6.0, 0.13), 1.1))
    for y in np.arange(23.6, 31.0, 1.2):
        parts += [bollard((side * (KERB_M + 0.3), y, 0.13)) for side in (-1, 1)]
    parts.append(sign((KERB_M + 0.3, 24.2, 0.13), (0.7, 0.04, 0.04)))
    parts.append(sign((-KERB_M - 0.3, 31.5, 0.13), (0.05, 0.12, 0.6)))
    for y, side in ((6.3, -1), (14.5, 1), (21.5, -1)):
        low = (side * 5.15 - 0.3, y, 0.13)
        parts.append(box(low, (low[0] + 0.5, y + 0.55, 1.15), NUMBER["paint"], (0.12, 0.26, 0.16), 0.3))
    return merge(parts)


def _greenery(rng: np.random.Generator, detail: float) -> Mesh:
    parts = []
    for k, (side, y) in enumerate(
        [(-1, 24.0), (1, 29.5), (-1, 36.5), (1, 46.0), (-1, 52.0), (1, 63.0), (-1, 70.0)]
    ):
        count = int(detail * (7000 if y < 40 else 4000))
        colour = ((0.20, 0.38, 0.09), (0.26, 0.40, 0.10))[k % 2]
        foot = (side * (KERB_M + 0.75), y, 0.13)
        size = 0.14 if y < 40 else 0.2
        parts.append(tree(rng, foot, rng.uniform(5.8, 7.2), rng.uniform(1.5, 1.9), count, size, colour))
    for side, y in ((1, 6.5), (-1, 10.6), (1, 18.0), (-1, 17.2)):
        x = side * 5.2
        parts.append(planter((x - 0.28, y, 0.13), (x + 0.28, y + 1.4, 0.63)))
        shrub = (x, y + 0.7, 0.9)
        parts.append(clump(rng, shrub, (0.32, 0.7, 0.42), int(1400 * detail), 0.09, (0.15, 0.33, 0.09)))
    return merge(parts)


def _background(rng: np.random.Generator, detail: float) -> Mesh:
    parts = [patch((-90, FAR_Y, -0.02), (180, 0, 0), (0, 60, 0), NUMBER["paving"], (1, 1, 1), 6.0)]
    for k in range(6):
        style = Style("plaster" if k % 2 else "ashlar", (0.95, 0.88 - 0.05 * (k % 3), 0.74), ground="plain")
        parts.append(
            facade(rng, 11.0, int(rng.integers(3, 6)), style).moved((-33.0 + 11.0 * k, FAR_Y + 12.0, 0))
        )
    parts.append(box((4.0, FAR_Y + 22, 0), (9.0, FAR_Y + 27, 24.0), NUMBER["ashlar"], (0.9, 0.88, 0.85), 4.0))
    spire = [(3.6, 24.0), (3.3, 25.0), (0.1, 36.0)]
    parts.append(lathe(spire, (6.5, FAR_Y + 24.5, 0), NUMBER["tiles"], (0.7, 0.8, 0.8), 8))
    for k in range(5):
        foot = (-12.0 + 6.0 * k, FAR_Y + 5.0 + math.sin(3.0 * k), 0)
        parts.append(tree(rng, foot, 8.5, 2.8, int(1800 * detail), 0.4))
    return merge(parts)


DESCRIPTION = Description(
    name="street",
    frame_rate=Fraction(30),
    num_frames=50,
    field_of_view_deg=56.0,
    exposure=0.62,
    shows="a street of town houses with parked cars, lamps and trees",
    motion="smooth, forward along the street; the epipole stays inside the image",
    purpose="triangulation near the epipole, large range of depths, growing scale",
    motion_px=(1.48, 1.35, 1.58),
    pose=_pose,
    geometry=_geometry,
    weather=Weather(azimuth_deg=-152.0, elevation_deg=52.0),
    light=LightMaps((0.0, 28.0, 2.0), 38.0, 2048, directions=36),
)
