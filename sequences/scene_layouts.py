"""The scenes: *street*, *stairway*, *statue*, *rounds* (the stairway from a closed path), and *toy*."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np

from dvc.arrays import Floats
from sequences import scenery
from sequences.scene_cameras import look_at, there_and_back, tremor
from sequences.scenery import IRON, MARBLE, PAINTS, PLASTERS, TILES, TRIM, Description, Style
from sequences.shapes import Look, Mesh, bar, box, ellipsoid, lathe, merge, patch, slab

BRICK, ASHLAR = Look("brick", (0.32, 0.14, 0.09)), Look("ashlar", (0.46, 0.41, 0.33))
STONE = Look("stone", (0.46, 0.43, 0.37))
ASPHALT = Look("asphalt", (0.13, 0.13, 0.125))
COBBLES, PAVING = Look("cobbles", (0.3, 0.28, 0.25)), Look("paving", (0.36, 0.34, 0.3))
WOOD = Look("wood", (0.3, 0.2, 0.12))
WALLS = (*(Look("plaster", colour) for colour in PLASTERS[:2]), BRICK, Look("plaster", PLASTERS[2]), ASHLAR)

STREET_SPEED_M, KERB_M, FRONT_M, NEAR_Y, FAR_Y = 0.17, 3.4, 5.6, -6.0, 92.0


def _along_street(index: float, seed: int) -> Floats:
    """Return a pose of a smooth ride with a slow sway."""
    time_s = index / 30
    y = STREET_SPEED_M * there_and_back(index, 240.0, 12.0)
    x = 0.55 + 0.10 * tremor(time_s, seed, 0.1, 0.4)
    z = 1.62 + 0.014 * tremor(time_s, seed + 1, 0.5, 1.4)
    turn = (0.10 * tremor(time_s, seed + 2, 0.4, 1.2), 0.25 * tremor(time_s, seed + 3, 0.2, 0.6), 0.0)
    return look_at((x, y, z), (x - 1.5, y + 30.0, z + 0.9), turn)


def _street(rng: np.random.Generator) -> Mesh:
    """Build the street."""
    length, white = FAR_Y - NEAR_Y, Look("paint", (0.62, 0.62, 0.6))
    parts = [patch((-KERB_M, NEAR_Y, 0), (2 * KERB_M, 0, 0), (0, length, 0), ASPHALT)]
    for left, kerb in ((KERB_M, KERB_M), (-FRONT_M - 0.1, -KERB_M - 0.16)):
        parts.append(patch((left, NEAR_Y, 0.13), (FRONT_M + 0.1 - KERB_M, 0, 0), (0, length, 0), PAVING))
        parts += [box((kerb, y, 0), (kerb + 0.16, y + 0.99, 0.14), TRIM) for y in np.arange(NEAR_Y, FAR_Y)]
    for y in np.arange(NEAR_Y, FAR_Y, 5.0):
        parts.append(patch((-0.06, y, 0.004), (0.12, 0, 0), (0, 2.4, 0), white))
    for x in np.arange(0.4 - KERB_M, KERB_M - 0.5):
        parts.append(patch((x, 26.0, 0.004), (0.5, 0, 0), (0, 3.0, 0), white))
    # house fronts
    for side in (-1, 1):
        y, k = NEAR_Y, 0
        while y < FAR_Y:
            width, floors = rng.uniform(6.5, 10.5), int(rng.integers(3, 5))
            paint = PAINTS[int(rng.integers(len(PAINTS)))]
            ground = ("shop", "door", "shop", "door", "door")[k % 5]
            style = Style(WALLS[(k + 2 * side) % 5], paint, ground, bool(rng.random() < 0.4))
            setback = FRONT_M + rng.uniform(0.0, 0.18)
            turn, start = (90.0, y) if side < 0 else (-90.0, y + width)
            parts.append(
                scenery.house(rng, width, floors, style).turned(turn).moved((side * setback, start, 0.12))
            )
            y, k = y + width, k + 1
    # parked cars, lamps, bollards, trees and tubs
    colours = [(0.4, 0.03, 0.03), (0.5, 0.5, 0.52), (0.05, 0.1, 0.3), (0.6, 0.58, 0.52), (0.05, 0.055, 0.06)]
    colours += [(0.1, 0.2, 0.13), (0.42, 0.33, 0.18)]
    for k, y in enumerate((11.0, 16.6, 22.0, 35.5, 41.0, 52.0, 58.0, 70.0)):
        parts.append(scenery.car(colours[k % 7]).turned(180.0 + rng.uniform(-1.5, 1.5)).moved((2.45, y, 0)))
    for k, y in enumerate((8.0, 13.4, 19.5, 33.0, 44.0, 49.5, 62.0)):
        parts.append(scenery.car(colours[(k + 3) % 7]).turned(rng.uniform(-1.5, 1.5)).moved((-2.45, y, 0)))
    for y in (9.5, 25.0, 40.5, 56.0, 72.0):
        parts += [
            scenery.lamp((KERB_M + 0.35, y, 0.13), -1.1),
            scenery.lamp((-KERB_M - 0.35, y + 6.0, 0.13), 1.1),
        ]
    for y in np.arange(23.6, 31.0, 1.2):
        parts += [scenery.bollard((side * (KERB_M + 0.3), y, 0.13)) for side in (-1, 1)]
    for side, y in ((-1, 24.0), (1, 29.5), (-1, 36.5), (1, 46.0), (-1, 52.0), (1, 63.0), (-1, 70.0)):
        foot = (side * (KERB_M + 0.75), y, 0.13)
        parts.append(scenery.tree(rng, foot, rng.uniform(5.8, 7.2), rng.uniform(1.5, 1.9)))
    for side, y in ((1, 6.5), (-1, 10.6), (1, 18.0), (-1, 17.2)):
        parts.append(box((side * 5.2 - 0.28, y, 0.13), (side * 5.2 + 0.28, y + 1.4, 0.63), TRIM))
        parts += [scenery.clump(rng, (side * 5.2, y + d, 0.8), 0.36) for d in (0.25, 0.7, 1.15)]
    # the end of the street
    parts.append(patch((-90, FAR_Y, -0.02), (180, 0, 0), (0, 60, 0), PAVING))
    for k in range(6):
        front = scenery.house(rng, 11.0, int(rng.integers(3, 6)), Style(WALLS[k % 5], ground="plain"))
        parts.append(front.moved((-33.0 + 11.0 * k, FAR_Y + 12.0, 0)))
    parts.append(box((4.0, FAR_Y + 22, 0), (9.0, FAR_Y + 27, 26.0), ASHLAR))
    spire = lathe([(3.8, 0.0), (0.1, 12.0)], (6.5, FAR_Y + 24.5, 26.0), TILES, 4)
    parts.append(spire)
    parts += [scenery.tree(rng, (x, FAR_Y + 5.0, 0), 8.5, 2.8) for x in (-10.0, -4.0, 3.0)]
    return merge(parts)


STREET = Description(
    name="street",
    frame_rate=Fraction(30),
    num_frames=50,
    field_of_view_deg=56.0,
    exposure=0.5,
    shows="a street of town houses with parked cars, lamps and trees",
    motion="smooth, forward along the street; the epipole stays inside the image",
    purpose="triangulation near the epipole, large range of depths, growing scale",
    motion_px=(2.39, 2.26, 2.55),
    pose=_along_street,
    geometry=_street,
    sun_deg=(-152.0, 52.0),
    shadows=((0.0, 28.0, 2.0), 38.0),
    shadow_size=2048,
)

NUM_STEPS, RISE_M, TREAD_M = 16, 0.16, 0.33
LEFT_M, RIGHT_M = -2.6, 2.5
TOP_Y, TOP_Z = NUM_STEPS * TREAD_M, NUM_STEPS * RISE_M


def _past_stairway(index: float, seed: int) -> Floats:
    """Return a pose of sideways steps and a trembling hand."""
    time_s = index / 30
    x = -1.3 + 0.042 * there_and_back(index, 62.0, 5.0) + 0.010 * tremor(time_s, seed, 1.0, 2.5)
    y = -4.9 + 0.02 * tremor(time_s, seed + 1, 0.3, 1.0)
    z = 1.72 + 0.008 * tremor(time_s, seed + 2, 1.5, 3.0)
    tilt = 0.17 * tremor(time_s, seed + 3, 2.0, 5.5) + 0.25 * tremor(time_s, seed + 4, 0.3, 1.2)
    pan = 0.14 * tremor(time_s, seed + 5, 2.0, 5.5) + 0.25 * tremor(time_s, seed + 6, 0.3, 1.0)
    roll = 0.10 * tremor(time_s, seed + 7, 0.8, 3.0)
    return look_at((x, y, z), (x + 0.25, y + 10.0, z + 0.75), (tilt, pan, roll))


ROUND = 120


def _round(index: float, seed: int) -> Floats:
    """Return a pose on an ellipse over the ground; the gaze turns left and right once a round."""
    time_s, angle = index / 30, 2.0 * math.pi * index / ROUND
    aside = 0.06 * math.sin(0.5 * angle)  # of the second round, metres
    x = -0.3 + (1.0 + aside) * math.cos(angle) + 0.006 * tremor(time_s, seed, 1.0, 2.5)
    y = -4.6 + (0.5 + aside) * math.sin(angle)
    z = 1.72 + aside + 0.006 * tremor(time_s, seed + 2, 1.5, 3.0)
    tilt = 0.14 * tremor(time_s, seed + 3, 2.0, 5.5)
    pan = 16.0 * math.sin(angle) + 0.12 * tremor(time_s, seed + 5, 2.0, 5.5)
    return look_at((x, y, z), (x + 0.25, y + 10.0, z + 0.75), (tilt, pan, 0.0))


def _stairway(rng: np.random.Generator) -> Mesh:
    """Build the stairway."""
    parts = []
    for k in range(NUM_STEPS):
        step = [box((LEFT_M, 0.02, -0.1), (RIGHT_M, 0.5, RISE_M - 0.02), STONE.shaded(0.3))]
        edges = np.linspace(LEFT_M, RIGHT_M, 5)
        edges[1:4] += 0.35 * rng.uniform(-1.0, 1.0, 3)
        for left, right in zip(edges[:-1] + 0.004, edges[1:] - 0.004, strict=True):
            look, y = STONE.shaded(rng.uniform(0.75, 1.2)), rng.uniform(-0.008, 0.008)
            z = RISE_M + rng.uniform(-0.006, 0.004)
            step.append(box((left, y, 0.0), (right, y + TREAD_M + 0.03, z - 0.045), look))
            step.append(box((left, y - 0.03, z - 0.045), (right, y + TREAD_M, z), look))
        parts.append(merge(step).moved((0, k * TREAD_M, k * RISE_M)))
    # the left wall
    x, end = LEFT_M, TOP_Y + 2.6
    parts += [
        box((x - 0.3, -0.6, 0), (x, end, 4.6), BRICK),
        box((x - 2.9, -0.6, 0), (x - 0.2, -0.3, 4.6), BRICK),
        slab((x, 0, 0), (0.12, 0, 0), (0, TOP_Y, TOP_Z), (0, 0, 0.42), STONE.shaded(0.8)),
        box((x - 0.42, -0.78, 0), (x + 0.06, -0.3, 4.9), ASHLAR),
        box((x - 0.52, -0.88, 4.9), (x + 0.16, -0.2, 5.05), STONE),
        bar([(x + 0.1, 0, 0.98), (x + 0.1, TOP_Y, TOP_Z + 0.98)], [0.024, 0.024], IRON),
    ]
    for y in np.arange(-0.6, end, 0.65):
        coping = TRIM.shaded(rng.uniform(0.8, 1.2))
        parts.append(box((x - 0.35, y + 0.01, 4.6), (x + 0.1, y + 0.64, 4.72), coping))
    for k in range(70):  # ivy
        hang = rng.random() ** 1.6
        at = (x + 0.04, rng.uniform(0.4, 5.6)) if k < 50 else (x - rng.uniform(0.8, 2.8), -0.66)
        parts.append(scenery.clump(rng, (*at, 4.6 - 2.4 * hang), rng.uniform(0.14, 0.3)))
    # the balustrade
    x, slope = RIGHT_M, (0, TOP_Y, TOP_Z)
    parts.append(slab((x, 0, 0), (0.36, 0, 0), slope, (0, 0, 0.34), STONE))
    parts.append(slab((x - 0.04, 0, 1.02), (0.44, 0, 0), slope, (0, 0, 0.13), STONE))
    outline = np.array([(0.065, 0), (0.065, 0.06), (0.04, 0.1), (0.075, 0.28), (0.034, 0.6), (0.06, 0.78)])
    for t in (np.arange(27) + 0.5) / 27:
        parts.append(lathe(outline, (x + 0.18, TOP_Y * t, TOP_Z * t + 0.28), MARBLE, 10))
    for y, z in ((-0.42, 0.0), (TOP_Y, TOP_Z)):
        parts.append(box((x - 0.06, y, z), (x + 0.44, y + 0.5, z + 1.25), ASHLAR))
        parts.append(box((x - 0.12, y - 0.06, z + 1.25), (x + 0.5, y + 0.56, z + 1.36), STONE))
        parts.append(ellipsoid((x + 0.19, y + 0.25, z + 1.54), (0.18, 0.18, 0.18), MARBLE))
    # the terrace
    base = RIGHT_M + 0.4
    ochre = Style(Look("plaster", PLASTERS[0]), PAINTS[2], "door", True)
    parts += [
        patch((-12, -9, 0), (24, 0, 0), (0, 9.2, 0), PAVING),
        patch((LEFT_M, TOP_Y, TOP_Z), (14.0, 0, 0), (0, 3.4, 0), PAVING),
        scenery.house(rng, 7.2, 2, ochre).moved((LEFT_M - 0.4, TOP_Y + 3.0, TOP_Z)),
        scenery.house(rng, 8.0, 3, Style(ASHLAR, PAINTS[1], "plain")).moved((4.2, TOP_Y + 3.3, TOP_Z)),
        scenery.lamp((1.6, TOP_Y + 2.4, TOP_Z), -0.5, 3.4),
        box((base, 1.6, 0), (base + 8.0, 5.6, TOP_Z + 0.02), ASHLAR),
        box((base, 1.48, TOP_Z - 0.06), (base + 8.0, 5.6, TOP_Z + 0.1), STONE),
        bar([(base, 1.72, TOP_Z + 1.05), (base + 8.0, 1.72, TOP_Z + 1.05)], [0.022, 0.022], IRON),
    ]
    for x in base + 0.3 + 0.5 * np.arange(16):
        parts.append(bar([(x, 1.72, TOP_Z + 0.1), (x, 1.72, TOP_Z + 1.05)], [0.018, 0.018], IRON))
    for x, y, z, high in ((-5.2, 3.0, 0.0, 8.0), (-4.4, 8.5, TOP_Z, 9.0), (11.0, 9.0, TOP_Z, 9.5)):
        parts.append(scenery.tree(rng, (x, y, z), high, 2.3))
    pot = np.array([(0.62, 0), (1.0, 1.35), (1.12, 1.4), (1.12, 1.65), (0.01, 1.65)])
    for x, y, r in ((-2.1, -1.05, 0.24), (2.75, -1.0, 0.27), (-1.62, -0.75, 0.17)):
        parts.append(lathe(r * pot, (x, y, 0), Look("stone", (0.46, 0.22, 0.13)), 20))
        parts.append(scenery.clump(rng, (x, y, 2.9 * r), 1.7 * r))
    return merge(parts)


STAIRWAY = Description(
    name="stairway",
    frame_rate=Fraction(30),
    num_frames=50,
    field_of_view_deg=52.0,
    exposure=0.49,
    shows="a flight of stone steps between a brick wall with ivy and a balustrade, a house above",
    motion="sideways, with the tremor of a hand, up to 7 px between frames",
    purpose="edges along epipolar lines (the aperture problem), motion that is not smooth in time",
    motion_px=(2.23, 0.84, 3.53),
    pose=_past_stairway,
    geometry=_stairway,
    sun_deg=(-140.0, 46.0),
    shadows=((0.0, 2.5, 2.0), 12.0),
)
ROUNDS = replace(
    STAIRWAY,
    name="rounds",
    num_frames=2 * ROUND,
    motion="two rounds on a closed path, turning to the left and right, with the tremor of a hand",
    purpose="views that come back: the second round shows the same things as the first",
    motion_px=(4.11, 0.78, 7.06),
    pose=_round,
)

STATUE_RADIUS_M, STATUE_TURN_DEG, PEDESTAL_M = 5.6, 0.6, 1.55


def _round_statue(index: float, seed: int) -> Floats:
    """Return a pose on an arc round the statue, with a light tremor."""
    time_s = index / 25
    angle = math.radians(-22.0 + STATUE_TURN_DEG * there_and_back(index, 74.0, 5.0))
    radius = STATUE_RADIUS_M + 0.05 * tremor(time_s, seed, 0.2, 0.7)
    z = 1.68 + 0.012 * tremor(time_s, seed + 1, 0.8, 2.0)
    turn = [0.10 * tremor(time_s, seed + 2 + k, 0.8, 3.5) for k in range(2)]
    eye = (radius * math.sin(angle), -radius * math.cos(angle), z)
    return look_at(eye, (0.0, 0.0, 2.02), (turn[0], turn[1], 0.08 * tremor(time_s, seed + 4, 0.5, 2.0)))


def _statue(rng: np.random.Generator) -> Mesh:
    """Build the square with the statue."""
    parts = [scenery.figure().moved((0, 0, PEDESTAL_M))]
    levels = (0.0, 0.16, 0.3, 0.42, 1.34, 1.46, PEDESTAL_M)
    for k, half in enumerate((0.75, 0.65, 0.57, 0.49, 0.62, 0.45)):
        look = STONE if k < 2 else MARBLE.shaded(0.9)
        parts.append(box((-half, -half, levels[k]), (half, half, levels[k + 1]), look))
    parts.append(box((-0.34, -0.51, 0.6), (0.34, -0.48, 1.14), Look("print", (0.2, 0.18, 0.14))))
    for radius, low in ((2.35, -0.1), (1.75, 0.01)):
        rim = [(radius, low), (radius, low + 0.1), (radius - 0.02, low + 0.11), (0.2, low + 0.11)]
        parts += [lathe(rim[k : k + 2], (0, 0, 0), STONE, 48) for k in range(3)]
    # the square
    parts.append(patch((-40, -14, 0), (80, 0, 0), (0, 34, 0), COBBLES))
    x = -31.0
    for y, wide in ((6.2, 0.35), (6.9, 0.35), (9.0, 2.3)):
        parts.append(patch((-30, y, 0.006), (60, 0, 0), (0, wide, 0), PAVING))
    for k in range(7):
        width, floors = float(rng.uniform(7.5, 10.0)), int(rng.integers(3, 5))
        style = Style(WALLS[(2 * k) % 5], PAINTS[k % 4], ("shop", "door", "plain")[k % 3], k % 3 == 0)
        parts.append(scenery.house(rng, width, floors, style).moved((x, 13.6 + 0.15 * (k % 2), 0)))
        x += width
    for x, y in ((-10.5, 9.6), (-14.0, 6.5), (9.4, 9.8), (13.0, 7.0), (18.0, 9.0)):
        parts.append(scenery.tree(rng, (x, y, 0), rng.uniform(6.4, 7.4), 1.9))
    # the portico
    parts += [
        box((-6.0, 10.8, 0.0), (5.2, 13.6, 0.36), STONE),
        box((-6.0, 10.9, 4.56), (5.2, 13.6, 5.1), ASHLAR),
        box((-6.3, 10.6, 5.1), (5.5, 13.6, 5.3), STONE),
        patch((-6.3, 10.6, 5.3), (11.8, 0, 0), (0, 3.0, 1.0), TILES),
        *(scenery.column((-5.4 + 2.0 * k, 11.4, 0.36), 4.2, 0.27) for k in range(6)),
    ]
    # lamps, bollards, benches and tubs
    parts += [scenery.lamp((x, 7.9, 0), 0.6, 3.8) for x in (-12.0, -5.6, 6.4, 13.5)]
    parts += [scenery.bollard((x, 5.3, 0)) for x in np.arange(-13.5, 14.0, 1.5)]
    for angle in np.radians(np.arange(15.0, 375.0, 30.0)):
        parts.append(scenery.bollard((3.1 * math.sin(angle), 3.1 * math.cos(angle), 0)))
    for x in (-9.5, -3.0, 3.2, 9.6):  # benches
        parts += [box((x - 0.9, y, 0.43), (x + 0.9, y + 0.1, 0.47), WOOD) for y in (8.6, 8.72, 8.84, 8.96)]
        parts += [box((x - 0.9, 9.06, z), (x + 0.9, 9.1, z + 0.11), WOOD) for z in (0.58, 0.73)]
        parts += [box((x + dx, 8.6, 0.0), (x + dx + 0.05, 9.06, 0.43), IRON) for dx in (-0.75, 0.7)]
    for x in (-8.0, 1.0, 8.0):
        parts.append(box((x - 0.9, 6.0, 0), (x + 0.9, 6.7, 0.5), TRIM))
        parts += [scenery.clump(rng, (x + dx, 6.35, 0.66), 0.34) for dx in (-0.55, 0.0, 0.55)]
    return merge(parts)


STATUE = Description(
    name="statue",
    frame_rate=Fraction(25),
    num_frames=50,
    field_of_view_deg=50.0,
    exposure=0.47,
    shows="a robed figure on a pedestal in a square with a portico, houses and trees",
    motion="sideways on an arc round the statue, with a light tremor",
    purpose="large occlusions, a smooth curved surface, background that moves faster than the subject",
    motion_px=(2.46, 1.83, 3.19),
    pose=_round_statue,
    geometry=_statue,
    sun_deg=(-118.0, 44.0),
    shadows=((0.0, 7.0, 2.0), 21.0),
    shadow_size=2048,
)

POSITIONS = ((0, 0), (1, 0), (0, 1), (1, 1))
"""Positions (m, n) of the cameras: m to the right, n downwards."""
STEP_RIGHT_M, STEP_DOWN_M = 0.24, 0.17
UPPER_LEFT_M = np.array([-0.12, 0.0, 1.32])
TURNS_DEG = ((0.8, -1.5, 1.2), (-0.6, 1.1, -0.8), (1.2, 0.7, -1.6), (-1.0, -0.9, 0.9))


def _of_array(index: float, seed: int) -> Floats:
    """Return the camera of a position; all look roughly at the middle of the scene."""
    del seed
    m, n = POSITIONS[int(index)]
    eye = UPPER_LEFT_M + np.array([m * STEP_RIGHT_M, 0.0, -n * STEP_DOWN_M])
    target = eye + np.array([0.05 - 0.12 * m, 4.0, -0.35 + 0.1 * n])
    return look_at(eye, target, TURNS_DEG[int(index)])


def _toy(rng: np.random.Generator) -> Mesh:
    """Build the room; nothing in it is random."""
    del rng
    vase = [(0.10, 0.0), (0.20, 0.12), (0.24, 0.3), (0.20, 0.48), (0.10, 0.6), (0.09, 0.68), (0.13, 0.74)]
    tower = box((-0.2, -0.18, 0.0), (0.2, 0.17, 0.72), Look("print", (0.12, 0.3, 0.5))).turned(12.0)
    parts = [
        patch((-6, -1, 0), (12, 0, 0), (0, 9.0, 0), WOOD),
        patch((-6, 6.0, 0), (12, 0.8, 0), (0, 0, 6), BRICK),
        box((-1.35, 3.3, 0.0), (-0.55, 3.9, 1.05), Look("print", (0.5, 0.3, 0.12))),
        tower.moved((-0.05, 2.72, 0.0)),
        box((0.55, 4.4, 0.0), (1.45, 5.0, 1.55), ASHLAR).turned(-6.0),
        box((-0.6, 5.0, 0.0), (0.3, 5.3, 1.9), TILES),
        scenery.column((-0.35, 3.75, 0.0), 1.5, 0.13),
        lathe([*vase, (0.02, 0.74)], (0.62, 2.75, 0.0), Look("cobbles", (0.5, 0.33, 0.16)), 24),
    ]
    return merge(parts)


TOY = Description(
    name="toy",
    frame_rate=Fraction(1),
    num_frames=len(POSITIONS),
    field_of_view_deg=52.0,
    exposure=0.62,
    shows="boxes, a column and a vase before a brick wall",
    motion="none: four pictures of a planar array of two by two cameras, not rectified",
    purpose="stereo from camera arrays: exact depth, axes that are not parallel, cells that are not square",
    motion_px=(0.0, 0.0, 0.0),
    pose=_of_array,
    geometry=_toy,
    sun_deg=(-35.0, 62.0),
    shadows=((0.0, 3.5, 1.0), 6.0),
)

VIDEO_SCENES = {each.name: each for each in (STREET, STAIRWAY, STATUE, ROUNDS)}
ARRAY_SCENES = {TOY.name: TOY}
