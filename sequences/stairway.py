"""*stairway*: sideways past a flight of stone steps, with the tremor of a hand; strong horizontal edges."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sequences.architecture import facade, weathered
from sequences.cameras import look_at, there_and_back, tremor
from sequences.description import Description
from sequences.foliage import clump, ivy, leaves, tree, tufts
from sequences.lighting import LightMaps, Weather
from sequences.meshes import Mesh, merge, patch
from sequences.openings import Opening, Style, fill, wall
from sequences.props import baluster, lamp
from sequences.shapes import box, extrude, lathe, slab, tube
from sequences.textures import NUMBER

Floats = NDArray[np.float64]

NUM_STEPS, RISE_M, TREAD_M = 16, 0.16, 0.33
LEFT_M, RIGHT_M = -2.6, 2.5
TOP_Y, TOP_Z = NUM_STEPS * TREAD_M, NUM_STEPS * RISE_M
SPEED_M = 0.042


def _pose(index: float, seed: int) -> Floats:
    """Sideways steps and a trembling hand."""
    time_s = index / 30
    x = -1.3 + SPEED_M * there_and_back(index, 62.0, 5.0) + 0.010 * tremor(time_s, seed, 1.0, 2.5)
    y = -4.9 + 0.02 * tremor(time_s, seed + 1, 0.3, 1.0)
    z = 1.72 + 0.008 * tremor(time_s, seed + 2, 1.5, 3.0)
    tilt = 0.17 * tremor(time_s, seed + 3, 2.0, 5.5) + 0.25 * tremor(time_s, seed + 4, 0.3, 1.2)
    pan = 0.14 * tremor(time_s, seed + 5, 2.0, 5.5) + 0.25 * tremor(time_s, seed + 6, 0.3, 1.0)
    roll = 0.10 * tremor(time_s, seed + 7, 0.8, 3.0)
    return look_at((x, y, z), (x + 0.25, y + 10.0, z + 0.75), (tilt, pan, roll))


def _geometry(rng: np.random.Generator, detail: float) -> Mesh:
    """Build the stairway; `detail` is the share of the leaves."""
    return merge(
        [_steps(rng), _left_wall(rng), _right_balustrade(rng), _top(rng), _front(rng), _plants(rng, detail)]
    )


def _steps(rng: np.random.Generator) -> Mesh:
    parts = []
    profile = np.array(
        [(-TREAD_M - 0.02, RISE_M), (0.02, RISE_M), (0.032, RISE_M - 0.012), (0.03, RISE_M - 0.04)]
    )
    profile = np.concatenate([profile, [(0.0, RISE_M - 0.052), (0.0, 0.0)]])
    inner = profile - [0.014, 0.012]
    for k in range(NUM_STEPS):
        line = (LEFT_M, k * TREAD_M, k * RISE_M), (RIGHT_M, k * TREAD_M, k * RISE_M)
        parts.append(extrude(inner, *line, NUMBER["stone"], (0.34, 0.32, 0.28), 0.5))
        cuts = np.sort(LEFT_M + (RIGHT_M - LEFT_M) * (np.arange(1, 4) + rng.uniform(-0.28, 0.28, 3)) / 4)
        edges = [LEFT_M, *cuts, RIGHT_M]
        for left, right in pairwise(edges):
            sunk = rng.uniform(-0.006, 0.004)
            y, z = k * TREAD_M + rng.uniform(-0.006, 0.006), k * RISE_M + sunk
            stone = extrude(
                profile, (left + 0.004, y, z), (right - 0.004, y, z), NUMBER["stone"], (1, 1, 1), 0.2
            )
            shade = rng.uniform(0.82, 1.15) * np.array([1.0, rng.uniform(0.97, 1.0), rng.uniform(0.92, 1.0)])
            worn = np.exp(-((stone.points[:, :1] / 1.1) ** 2)) * (stone.points[:, 2:] > z + RISE_M - 0.03)
            parts.append(stone.texture_moved(*rng.uniform(0, 9, 2)).tinted(shade * (0.88 + 0.26 * worn)))
    return merge(parts)


def _left_wall(rng: np.random.Generator) -> Mesh:
    x, end = LEFT_M, TOP_Y + 3.2
    stone, brick = NUMBER["stone"], NUMBER["brick"]
    parts = [patch((x, -0.6, 0), (0, end, 0), (0, 0, 4.6), brick, (1.0, 0.97, 0.93), 0.25)]
    for k in range(9):
        y = -0.6 + k * end / 9
        low, high = (x - 0.35, y + 0.01, 4.6), (x + 0.1, y + end / 9 - 0.01, 4.72)
        parts.append(box(low, high, stone, (1.0, 0.97, 0.92), 0.4, uv_at=rng.uniform(0, 5)))
    slope = (0, TOP_Y, TOP_Z)
    parts.append(slab((x, 0, 0.0), (0.12, 0, 0), slope, (0, 0, 0.42), stone, (0.85, 0.83, 0.8), 0.3))
    parts.append(
        patch((x - 2.9, -0.6, 0), (2.9, 0, 0), (0, 0, 4.6), brick, (1.02, 0.96, 0.9), 0.3, (3.0, 0.0))
    )
    parts.append(box((x - 2.9, -0.72, 4.6), (x + 0.1, -0.3, 4.74), stone, (1.0, 0.97, 0.92), 0.4))
    parts.append(box((x - 0.42, -0.78, 0), (x + 0.06, -0.3, 4.9), NUMBER["ashlar"], (1, 0.98, 0.94), 0.35))
    parts.append(box((x - 0.52, -0.88, 4.9), (x + 0.16, -0.2, 5.05), stone, (1, 0.98, 0.94), 0.4))
    parts.append(box((x - 0.47, -0.83, 0), (x + 0.11, -0.25, 0.35), stone, (0.8, 0.78, 0.75), 0.3))
    rail = [(x + 0.1, TREAD_M * k, RISE_M * k + 0.98) for k in range(-1, NUM_STEPS + 2)]
    parts.append(tube(rail, [0.024] * len(rail), NUMBER["paint"], (0.10, 0.10, 0.11)))
    for k in range(0, NUM_STEPS + 1, 4):
        bracket = [(x, TREAD_M * k, RISE_M * k + 0.88), (x + 0.1, TREAD_M * k, RISE_M * k + 0.97)]
        parts.append(tube(bracket, [0.012, 0.012], NUMBER["paint"], (0.10, 0.10, 0.11)))
    return weathered(merge(parts), 0.35)


def _right_balustrade(_rng: np.random.Generator) -> Mesh:
    x, stone = RIGHT_M, NUMBER["stone"]
    tint = (1.08, 1.04, 0.97)
    slope = (0, TOP_Y, TOP_Z)
    parts = [slab((x, 0, 0), (0.36, 0, 0), slope, (0, 0, 0.34), stone, tint, 0.3)]
    parts.append(slab((x - 0.04, 0, 1.02), (0.44, 0, 0), slope, (0, 0, 0.13), stone, tint, 0.3))
    count = 27
    for k in range(count):
        t = (k + 0.5) / count
        parts.append(baluster((x + 0.18, TOP_Y * t, TOP_Z * t + 0.28), 0.78, tint))
    for y, z in ((-0.42, 0.0), (TOP_Y, TOP_Z)):
        parts.append(box((x - 0.06, y, z), (x + 0.44, y + 0.5, z + 1.25), NUMBER["ashlar"], tint, 0.3))
        parts.append(box((x - 0.12, y - 0.06, z + 1.25), (x + 0.5, y + 0.56, z + 1.36), stone, tint, 0.3))
        ball = [(0.11, 0.0), (0.08, 0.05)]
        ball += [(0.17 * np.sin(a), 0.2 - 0.17 * np.cos(a)) for a in np.linspace(0.5, np.pi - 0.01, 9)]
        parts.append(lathe(ball, (x + 0.19, y + 0.25, z + 1.36), NUMBER["marble"], tint, 18))
    return merge(parts)


def _top(rng: np.random.Generator) -> Mesh:
    parts = [patch((LEFT_M, TOP_Y, TOP_Z), (14.0, 0, 0), (0, 3.0, 0), NUMBER["paving"], (1, 1, 1), 0.3)]
    style = Style("plaster", (0.98, 0.84, 0.62), ground="door", paint=(0.16, 0.26, 0.2), shutters=True)
    parts.append(facade(rng, 7.2, 2, style).moved((LEFT_M - 0.4, TOP_Y + 3.0, TOP_Z)))
    other = Style("ashlar", (1, 1, 1), ground="plain", paint=(0.26, 0.2, 0.15))
    parts.append(facade(rng, 8.0, 3, other).moved((LEFT_M + 6.8, TOP_Y + 3.3, TOP_Z)))
    parts.append(lamp((1.6, TOP_Y + 2.4, TOP_Z), -0.5, 3.4))
    return merge(parts)


def _front(rng: np.random.Generator) -> Mesh:
    parts = [patch((-12, -9, 0), (24, 0, 0), (0, 9.2, 0), NUMBER["paving"], (1, 1, 1), 0.4)]
    base = RIGHT_M + 0.4
    opening = Opening(1.0, 0.15, 1.15, 2.35, "door")
    style = Style("plaster", (0.9, 0.88, 0.84), paint=(0.3, 0.12, 0.08))
    lower = [wall(8.0, 0.0, TOP_Z + 0.1, [opening], "ashlar", (1.0, 0.97, 0.92)), fill(rng, opening, style)]
    cap = [(0.0, 0.16), (0.12, 0.15), (0.12, 0.03), (0.05, -0.06), (0.0, -0.06)]
    lower.append(extrude(cap, (0, 0, TOP_Z), (8.0, 0, TOP_Z), NUMBER["stone"], (1.05, 1.0, 0.94)))
    parts.append(weathered(merge(lower)).moved((base, 1.6, 0)))
    parts.append(patch((base, 1.6, TOP_Z + 0.1), (8, 0, 0), (0, 4.0, 0), NUMBER["paving"], (1, 1, 1), 0.5))
    parts.append(
        patch((base, 5.6, 0), (0, -4.0, 0), (0, 0, TOP_Z + 0.1), NUMBER["ashlar"], (0.9, 0.88, 0.84), 0.4)
    )
    for k in range(16):
        post = [(base + 0.3 + 0.5 * k, 1.72, TOP_Z + 0.1), (base + 0.3 + 0.5 * k, 1.72, TOP_Z + 1.05)]
        parts.append(tube(post, [0.018, 0.018], NUMBER["paint"], (0.1, 0.1, 0.11)))
    for z in (0.35, 1.05):
        rail = [(base + 0.1, 1.72, TOP_Z + z), (base + 8.0, 1.72, TOP_Z + z)]
        parts.append(tube(rail, [0.022, 0.022], NUMBER["paint"], (0.1, 0.1, 0.11)))
    for x, y, r in ((-2.1, -1.05, 0.24), (2.75, -1.0, 0.27), (-1.62, -0.75, 0.17)):
        pot = [
            (0.62 * r, 0),
            (0.7 * r, 0.05),
            (r, 1.35 * r),
            (1.12 * r, 1.4 * r),
            (1.12 * r, 1.65 * r),
            (0.95 * r, 1.65 * r),
        ]
        parts.append(
            lathe(
                [*pot, (0.9 * r, 1.5 * r), (0.001, 1.5 * r)],
                (x, y, 0),
                NUMBER["stone"],
                (1.0, 0.52, 0.32),
                20,
            )
        )
    return merge(parts)


def _plants(rng: np.random.Generator, detail: float) -> Mesh:
    parts = []
    for x, y, z, size in ((-2.1, -1.05, 0.72, 0.42), (2.75, -1.0, 0.86, 0.5), (-1.62, -0.75, 0.45, 0.27)):
        radii = (size, size, 0.85 * size)
        parts.append(clump(rng, (x, y, z), radii, int(2600 * size * detail) + 20, 0.075, (0.17, 0.36, 0.09)))
    flowers = np.array([2.75, -1.0, 0.9]) + rng.normal(0, 0.27, (int(90 * detail) + 5, 3))
    up = np.tile([0.0, -0.6, 0.8], (len(flowers), 1))
    parts.append(leaves(rng, flowers, up, 0.06, (0.85, 0.10, 0.16)))
    parts.append(ivy(rng, (LEFT_M, 0.2, 1.6), (0, 5.4, 0), (0, 0, 3.05), int(11000 * detail)))
    parts.append(ivy(rng, (LEFT_M - 2.9, -0.6, 1.2), (2.2, 0, 0), (0, 0, 3.45), int(6500 * detail)))
    fallen = rng.uniform((LEFT_M + 0.1, 0.0, 0.0), (RIGHT_M - 0.1, TOP_Y, 0.0), (int(300 * detail) + 5, 3))
    fallen[:, 2] = (np.floor(fallen[:, 1] / TREAD_M) + 1) * RISE_M + 0.012
    parts.append(leaves(rng, fallen, np.tile([0.0, 0.0, 5.0], (len(fallen), 1)), 0.055, (0.45, 0.24, 0.07)))
    joints = rng.integers(0, NUM_STEPS, int(70 * detail) + 4)
    side = np.where(rng.random(len(joints)) < 0.6, LEFT_M + 0.16, RIGHT_M - 0.05) + rng.normal(
        0, 0.08, len(joints)
    )
    feet = np.stack([side, joints * TREAD_M - 0.01, joints * RISE_M], axis=-1)
    parts.append(tufts(rng, feet, 0.13))
    for x, y, high in ((-5.2, 3.0, 8.0), (-4.4, 8.5, 9.0), (11.0, 9.0, 9.5)):
        parts.append(tree(rng, (x, y, 0.0 if y < 5 else TOP_Z), high, 2.3, int(6500 * detail), 0.15))
    return merge(parts)


DESCRIPTION = Description(
    name="stairway",
    frame_rate=Fraction(30),
    num_frames=50,
    field_of_view_deg=52.0,
    exposure=0.56,
    shows="a flight of stone steps between a brick wall with ivy and a balustrade, a house above",
    motion="sideways, with the tremor of a hand, up to 7 px between frames",
    purpose="edges along epipolar lines (the aperture problem), motion that is not smooth in time",
    motion_px=(2.17, 0.83, 3.51),
    pose=_pose,
    geometry=_geometry,
    weather=Weather(azimuth_deg=-140.0, elevation_deg=46.0),
    light=LightMaps((0.0, 2.5, 2.0), 12.0),
)
