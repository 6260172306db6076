"""Descriptions of scenes, and parts of them: house fronts, trees, posts, cars, a figure; metres."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from dvc.arrays import Floats
from sequences.shapes import Colour, Look, Mesh, bar, box, ellipsoid, lathe, merge, patch, smooth_sheet

IRON = Look("paint", (0.04, 0.05, 0.05))
GLASS = Look("glass", (0.06, 0.08, 0.1))
TRIM = Look("stone", (0.48, 0.45, 0.39))
MARBLE = Look("marble", (0.56, 0.53, 0.47))
LEAVES = Look("leaves", (0.075, 0.12, 0.035))
TILES = Look("tiles", (0.3, 0.12, 0.07))
GROUND_FLOOR_M, STOREY_M = 3.4, 3.0
PLASTERS: tuple[Colour, ...] = ((0.62, 0.5, 0.33), (0.6, 0.56, 0.48), (0.53, 0.34, 0.26))
PAINTS: tuple[Colour, ...] = ((0.5, 0.48, 0.44), (0.2, 0.13, 0.09), (0.09, 0.14, 0.1), (0.1, 0.13, 0.19))


@dataclass(frozen=True)
class Description:
    """A scene as data: its texts for the catalogue, and the functions that build it."""

    name: str
    frame_rate: Fraction  # frames per second
    num_frames: int  # usual length of a sequence; any other works too
    field_of_view_deg: float  # horizontal
    exposure: float  # factor from radiance to the input of the tone curve
    shows: str  # one sentence each, for the catalogue
    motion: str
    purpose: str
    # mean, smallest and largest frame mean of true motion at 352x288, in pixels per frame
    motion_px: tuple[float, float, float]
    # function of frame number (a float) and seed to ``cam_from_world`` (3, 4), metres
    pose: Callable[[float, int], Floats]
    # function of a random generator to everything in the scene
    geometry: Callable[[np.random.Generator], Mesh]
    # azimuth of the sun, clockwise from forward (y), and its elevation
    sun_deg: tuple[float, float]
    # centre and radius of the ball within which surfaces cast shadows, metres
    shadows: tuple[tuple[float, float, float], float]
    shadow_size: int = 1536  # side of the shadow map, texels


@dataclass(frozen=True)
class Style:
    """Look of a house front."""

    wall: Look
    paint: Colour = PAINTS[0]  # colour of window frames, shutters and doors
    ground: str = "door"  # ``"shop"``, ``"door"`` or ``"plain"``
    shutters: bool = False  # whether windows have them


def house(rng: np.random.Generator, width: float, floors: int, style: Style, depth: float = 7.0) -> Mesh:
    """Build a house: x along its front, which faces -y, z up."""
    top, bays = GROUND_FLOOR_M + STOREY_M * (floors - 1), max(2, round(width / 2.3))
    parts = [
        box((0, 0, 0), (width, depth, top), style.wall),
        box((-0.05, -0.1, 0.0), (width + 0.05, 0, 0.55), TRIM.shaded(0.7)),
        box((0, -0.08, GROUND_FLOOR_M - 0.1), (width, 0, GROUND_FLOOR_M + 0.1), TRIM),
        box((-0.1, -0.28, top - 0.2), (width + 0.1, 0, top - 0.05), TRIM.shaded(0.9)),
        box((-0.2, -0.42, top - 0.05), (width + 0.2, 0.1, top + 0.12), TRIM),
        bar([(width - 0.2, -0.09, 0.2), (width - 0.2, -0.09, top - 0.3)], [0.05, 0.05], IRON.shaded(2.5)),
        patch((-0.2, -0.42, top + 0.12), (width + 0.4, 0, 0), (0, 4.0, 2.2), TILES),
    ]
    for _ in range(2):
        x, high = rng.uniform(0.6, width - 1.4), top + rng.uniform(2.2, 3.4)
        parts.append(box((x, 1.6, top + 0.4), (x + 0.8, 2.3, high), Look("brick", (0.33, 0.15, 0.09))))
    for floor in range(floors):
        for bay in range(bays):
            x, z = width * (bay + 0.5) / bays, GROUND_FLOOR_M + STOREY_M * (floor - 1) + 0.75
            if floor > 0:
                parts.append(opening((x, z), (1.0, 1.7), style))
            elif style.ground == "door" and bay == bays // 2:
                parts.append(door((x, 0.0), style))
            elif style.ground != "shop":
                parts.append(opening((x, 1.0), (1.1, 1.7), style))
    if style.ground == "shop":
        parts.append(shop(rng, width, Look("paint", style.paint)))
    return merge(parts)


def opening(foot: tuple[float, float], size: tuple[float, float], style: Style) -> Mesh:
    """Make a window on a front: panes behind a frame, a surround and a sill; `foot` is its middle below."""
    half, tall = 0.5 * size[0], size[1]
    wood = Look("paint", style.paint)
    parts = [box((-half, -0.02, 0.0), (half, 0.05, tall), GLASS)]
    parts += [
        box((x - 0.035, -0.05, 0.0), (x + 0.035, 0, tall), wood) for x in (0.035 - half, 0.0, half - 0.035)
    ]
    parts += [box((-half, -0.05, z), (half, 0, z + 0.06), wood) for z in (0.0, 0.62 * tall, tall - 0.06)]
    parts += [box((x, -0.1, 0.0), (x + 0.14, 0, tall), TRIM) for x in (-half - 0.14, half)]
    parts.append(box((-half - 0.2, -0.14, tall), (half + 0.2, 0, tall + 0.2), TRIM))
    parts.append(box((-half - 0.2, -0.2, -0.12), (half + 0.2, 0, 0.0), TRIM))
    if style.shutters:
        leaf = Look("wood", style.paint)
        parts += [box((x, -0.13, 0.0), (x + half, 0, tall), leaf) for x in (-2.0 * half - 0.14, half + 0.14)]
    return merge(parts).moved((foot[0], 0.0, foot[1]))


def door(foot: tuple[float, float], style: Style) -> Mesh:
    """Make a door with a step, a surround and a small window above it."""
    wood = Look("wood", style.paint)
    parts = [
        box((-0.55, -0.04, 0.1), (0.55, 0.05, 2.2), wood),
        box((-0.5, -0.04, 2.25), (0.5, 0.05, 2.6), GLASS),
    ]
    for x, z in ((-0.43, 0.3), (-0.43, 1.2), (0.07, 0.3), (0.07, 1.2)):
        parts.append(box((x, -0.06, z), (x + 0.36, 0, z + 0.75), wood.shaded(1.3)))
    parts += [box((x, -0.16, 0.1), (x + 0.24, 0, 2.7), TRIM) for x in (-0.8, 0.56)]
    parts += [box((-0.95, -0.26, 2.7), (0.95, 0, 2.95), TRIM), box((-0.9, -0.4, 0.0), (0.9, 0, 0.12), TRIM)]
    return merge(parts).moved((foot[0], 0.0, foot[1]))


def shop(rng: np.random.Generator, width: float, paint: Look) -> Mesh:
    """Make a shop front: large panes with goods, a sign board, and perhaps a striped awning."""
    count, height = max(2, int(width / 2.3)), GROUND_FLOOR_M - 0.25
    pitch = (width - 0.4) / count
    parts = [box((0.2, -0.06, 0.0), (width - 0.2, 0, height), paint.shaded(0.8))]
    parts.append(box((0.2, -0.22, height - 0.65), (width - 0.2, 0, height), paint.shaded(1.4)))
    sign = Look("print", (0.5, 0.45, 0.3))
    parts.append(box((0.9, -0.24, height - 0.5), (width - 0.9, 0, height - 0.15), sign))
    for x in 0.2 + pitch * np.arange(count):
        goods = Look("print", tuple(rng.uniform(0.1, 0.35) * rng.uniform(0.7, 1.3, 3)))
        parts.append(box((x + 0.15, -0.08, 0.5), (x + pitch - 0.15, 0, height - 0.75), goods))
        parts.append(box((x - 0.06, -0.2, 0.0), (x + 0.06, 0, height), paint.shaded(1.2)))
    for k in range(16 if rng.random() < 0.7 else 0):
        cloth = paint.shaded(2.0) if k % 2 else Look("paint", (0.7, 0.68, 0.62))
        step = (width - 0.4) / 16
        parts.append(patch((0.2 + k * step, -1.2, height - 1.0), (step, 0, 0), (0, 1.0, 0.45), cloth))
    return merge(parts)


def tree(rng: np.random.Generator, foot: ArrayLike, height: float, crown: float) -> Mesh:
    """Make a broad-leaved tree: a trunk, branches, and clumps of leaves."""
    fork, bark = 0.36 * height, Look("wood", (0.16, 0.12, 0.09))
    trunk = [(0, 0, 0), (0.03, 0, 0.5 * fork), (0, 0.05, 1.3 * fork)]
    parts = [bar(trunk, [0.032 * height, 0.024 * height, 0.016 * height], bark)]
    for k in range(12):
        angle, level = 2.4 * k + rng.uniform(-0.4, 0.4), (k + 0.5) / 12
        reach = crown * math.sin(math.pi * (0.22 + 0.66 * level)) * rng.uniform(0.45, 0.8)
        tip = (reach * math.cos(angle), reach * math.sin(angle), fork + (height - fork) * (0.1 + 0.8 * level))
        parts.append(bar([(0, 0, fork), tip], [0.012 * height, 0.004 * height], bark))
        parts.append(clump(rng, tip, crown * rng.uniform(0.36, 0.52)))
    return merge(parts).moved(foot)


def clump(rng: np.random.Generator, centre: ArrayLike, radius: float) -> Mesh:
    """Make a ball of leaves: a core and smaller balls on it."""
    leaves = LEAVES.shaded(rng.uniform(0.7, 1.3))
    parts = [ellipsoid((0, 0, 0), (radius, radius, 0.8 * radius), leaves.shaded(0.7), rng, 8)]
    for direction in rng.standard_normal((12, 3)):
        at = 0.85 * radius * direction / np.linalg.norm(direction) * [1.0, 1.0, 0.8]
        size = radius * rng.uniform(0.22, 0.42)
        parts.append(ellipsoid(at, (size, size, 0.6 * size), leaves.shaded(rng.uniform(0.75, 1.35)), rng, 5))
    return merge(parts).moved(centre)


def lamp(foot: ArrayLike, towards: float, height: float = 5.2) -> Mesh:
    """Make a street lamp with an arm that reaches `towards` metres along x."""
    post = lathe([(0.14, 0), (0.14, 0.5), (0.08, 0.62), (0.05, height)], (0, 0, 0), IRON)
    bend = [(0, 0, height), (0.4 * towards, 0, height + 0.2), (towards, 0, height + 0.2)]
    arm = bar(bend, [0.04] * 3, IRON)
    head = ellipsoid((towards, 0, height + 0.12), (0.3, 0.13, 0.1), IRON.shaded(4.0), rows=6)
    return merge([post, arm, head]).moved(foot)


def bollard(foot: ArrayLike) -> Mesh:
    """Make a low iron post with a ball on it."""
    post = lathe([(0.09, 0), (0.09, 0.12), (0.06, 0.2), (0.055, 0.85), (0.08, 0.9)], (0, 0, 0), IRON, 10)
    return merge([post, ellipsoid((0, 0, 0.97), (0.09, 0.09, 0.09), IRON, rows=6)]).moved(foot)


def column(foot: ArrayLike, height: float, radius: float) -> Mesh:
    """Make a round stone column with base and capital."""
    r, h = radius, height
    profile = [(1.35 * r, 0.0), (1.35 * r, 0.25 * r), (1.1 * r, 0.4 * r), (0.97 * r, 0.5 * r)]
    profile += [(0.93 * r, 0.4 * h), (0.82 * r, h - 0.8 * r), (1.25 * r, h - 0.4 * r)]
    profile += [(1.35 * r, h - 0.3 * r), (1.35 * r, h)]
    return lathe(profile, foot, MARBLE.shaded(0.9), 20)


def car(colour: Colour) -> Mesh:
    """Make a parked car of plain shapes, 4.2 m long, nose towards -y, on the ground at the origin."""
    paint, dark, pane = (Look("paint", c) for c in (colour, (0.02, 0.02, 0.02), (0.05, 0.06, 0.07)))
    parts = [
        box((-0.84, -2.05, 0.3), (0.84, 2.05, 0.75), paint),
        box((-0.84, -2.05, 0.75), (0.84, 2.05, 0.95), paint, (0.06, 0.15)),
        box((-0.76, -0.95, 0.95), (0.76, 1.9, 1.42), pane, (0.14, 0.55)),
        box((-0.63, -0.42, 1.42), (0.63, 1.37, 1.46), paint),
        box((-0.86, -2.12, 0.3), (0.86, 2.12, 0.45), dark),
    ]
    for x in (-0.8, 0.8):
        for y in (-1.3, 1.3):
            parts.append(ellipsoid((x, y, 0.33), (0.11, 0.33, 0.33), dark, rows=8))
            parts.append(ellipsoid((1.13 * x, y, 0.33), (0.03, 0.19, 0.19), dark.shaded(20.0), rows=6))
        left = 0.8 * x - 0.14
        parts.append(box((left, 2.0, 0.68), (left + 0.28, 2.08, 0.84), Look("paint", (0.4, 0.02, 0.02))))
        parts.append(box((left, -2.08, 0.6), (left + 0.28, -2.0, 0.72), Look("paint", (0.8, 0.8, 0.75))))
    return merge(parts)


def figure() -> Mesh:
    """Make a robed figure with a book and a staff, which faces -y, 2.2 m high."""
    turn = np.linspace(0.0, 2.0 * math.pi, 97)
    height, angle = np.meshgrid(np.linspace(0.0, 1.35, 40), turn, indexing="ij")
    fall = np.clip(1.0 - height / 1.15, 0.0, 1.0)
    folds = np.sin(11 * angle + 2.2 * np.sin(2.3 * height) + 1.2 * height)
    folds += 0.5 * np.sin(19 * angle - 3.0 * height)
    radius = (0.19 + 0.13 * fall**1.4) * (1.0 + (0.03 + 0.07 * fall) * folds)
    robe = np.stack([radius * np.cos(angle), 0.82 * radius * np.sin(angle), height], axis=-1)
    parts = [smooth_sheet(robe, MARBLE)]
    for centre, radii in (
        ((0.0, 0.0, 1.28), (0.22, 0.155, 0.3)),  # chest
        ((0.0, 0.0, 1.46), (0.27, 0.1, 0.09)),  # shoulders
        ((0.01, -0.015, 1.725), (0.086, 0.102, 0.125)),  # head
        ((0.01, 0.03, 1.77), (0.1, 0.1, 0.1)),  # hair
        ((0.01, -0.075, 1.62), (0.058, 0.055, 0.075)),  # beard
        ((0.01, -0.115, 1.72), (0.016, 0.024, 0.03)),  # nose
        ((0.475, -0.255, 2.2), (0.05, 0.05, 0.06)),  # top of the staff
    ):
        parts.append(ellipsoid(centre, radii, MARBLE, rows=14))
    for path, thick in (
        ([(0.01, 0.0, 1.42), (0.01, -0.01, 1.66)], [0.07, 0.056]),  # neck
        ([(0.22, 0.0, 1.45), (0.4, -0.05, 1.22), (0.46, -0.22, 1.43)], [0.085, 0.072, 0.05]),
        ([(-0.2, 0.0, 1.45), (-0.31, -0.03, 1.12), (-0.12, -0.24, 1.1)], [0.085, 0.074, 0.05]),
        ([(0.475, -0.255, 0.0), (0.475, -0.255, 2.18)], [0.021, 0.021]),  # staff
    ):
        parts.append(bar(path, thick, MARBLE))
    for k in range(9):  # a sash from the left shoulder, in folds
        line = np.array([[-0.2, 0.02, 1.46], [0.0, -0.17, 1.23], [0.2, -0.13, 1.0]])
        line += k * np.array([[-0.015, -0.02, 0.0], [-0.022, -0.01, -0.018], [-0.03, 0.0, -0.035]])
        parts.append(bar(line, [0.03, 0.036, 0.022], MARBLE))
    parts.append(box((-0.2, -0.29, 1.05), (0.0, -0.23, 1.3), MARBLE.shaded(0.9)))  # a book
    return merge(parts)
