"""Holes in walls and what fills them: windows, doors, their frames and surrounds.

A wall is built in its own frame: x along it, y into the building, z up; it faces -y.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from sequences.meshes import Colour, Mesh, merge, patch
from sequences.shapes import box
from sequences.textures import NUMBER

RECESS_M = 0.2
PAINTS: tuple[Colour, ...] = ((0.9, 0.88, 0.82), (0.26, 0.2, 0.15), (0.16, 0.26, 0.2), (0.75, 0.75, 0.74))


@dataclass(frozen=True)
class Opening:
    """A hole in a wall: left edge, bottom, width and height in metres, and what fills it."""

    x: float
    z: float
    width: float
    height: float
    kind: str = "window"


@dataclass(frozen=True)
class Style:
    """Look of a facade."""

    material: str  # texture of the wall
    tint: Colour  # its colour
    trim: Colour = (0.95, 0.92, 0.85)  # colour of cornices, sills and surrounds
    paint: Colour = PAINTS[0]  # colour of window frames and doors
    ground: str = "door"  # ``"shop"``, ``"door"`` or ``"plain"``
    shutters: bool = False  # whether windows have them


def on_sheet(mesh: Mesh, column: int, row: int, across: int) -> Mesh:
    """Map the texture coordinates of a patch onto one picture of a sheet of ``across**2`` pictures."""
    low, high = mesh.uv.min(axis=0), mesh.uv.max(axis=0)
    unit = (mesh.uv - low) / np.maximum(high - low, 1e-9)
    unit[:, 1] = 1.0 - unit[:, 1]
    return replace(mesh, uv=(np.array([column, row]) + 0.03 + 0.94 * unit) / across)


def wall(
    width: float, bottom: float, top: float, openings: list[Opening], material: str, tint: ArrayLike
) -> Mesh:
    """Make a flat wall with rectangular holes; texture coordinates run on through the whole wall."""
    levels = sorted({bottom, top, *(o.z for o in openings), *(o.z + o.height for o in openings)})
    parts = []
    for low, high in pairwise(levels):
        holes = sorted(
            (o.x, o.x + o.width) for o in openings if o.z < high - 1e-9 and o.z + o.height > low + 1e-9
        )
        edges = [0.0, *(edge for hole in holes for edge in hole), width]
        for left, right in zip(edges[0::2], edges[1::2], strict=True):
            if right - left > 1e-6:
                across, up = (right - left, 0, 0), (0, 0, high - low)
                parts.append(patch((left, 0, low), across, up, NUMBER[material], tint, 0.4, (left, low)))
    return merge(parts)


def reveal(o: Opening, material: str, tint: ArrayLike, depth: float = RECESS_M) -> Mesh:
    """Make the four inner sides of a hole in a wall."""
    number, x1, z1 = NUMBER[material], o.x + o.width, o.z + o.height
    sides = [
        ((o.x, 0, o.z), (0, depth, 0), (0, 0, o.height)),
        ((x1, depth, o.z), (0, -depth, 0), (0, 0, o.height)),
        ((o.x, 0, o.z), (o.width, 0, 0), (0, depth, 0)),
        ((o.x, depth, z1), (o.width, 0, 0), (0, -depth, 0)),
    ]
    return merge(patch(*side, number, tint, 0.6) for side in sides)


def frame(o: Opening, bars: tuple[int, int], paint: ArrayLike, thick: float = 0.06) -> Mesh:
    """Make the wooden frame of a window, divided into ``bars`` panes across and up."""
    front, back = RECESS_M - 0.07, RECESS_M
    parts = []
    for x in np.linspace(o.x, o.x + o.width - thick, bars[0] + 1):
        parts.append(box((x, front, o.z), (x + thick, back, o.z + o.height), NUMBER["paint"], paint, 0.8))
    for z in np.linspace(o.z, o.z + o.height - thick, bars[1] + 1):
        low, high = (o.x + thick, front + 0.015, z), (o.x + o.width - thick, back, z + thick)
        parts.append(box(low, high, NUMBER["paint"], paint, 0.8))
    return merge(parts)


def fill(rng: np.random.Generator, o: Opening, style: Style) -> Mesh:
    """Fill a hole with a window or a door."""
    return (_door if o.kind == "door" else _window)(rng, o, style)


def _window(rng: np.random.Generator, o: Opening, style: Style) -> Mesh:
    """Fill a hole with glass, frame, sill, surround and, if the style says so, shutters."""
    glass = patch((o.x, RECESS_M, o.z), (o.width, 0, 0), (0, 0, o.height), NUMBER["glass"], (1, 1, 1), 0.7)
    parts = [on_sheet(glass, int(rng.integers(4)), int(rng.integers(4)), 4), reveal(o, "plaster", style.trim)]
    parts.append(frame(o, (2, 3 if o.height > 1.5 else 2), style.paint))
    x1, z1 = o.x + o.width, o.z + o.height
    stone = NUMBER["stone"]
    parts.append(box((o.x - 0.12, -0.14, o.z - 0.1), (x1 + 0.12, 0.02, o.z), stone, style.trim, 0.5))
    parts.append(box((o.x - 0.16, -0.05, z1), (x1 + 0.16, 0.0, z1 + 0.22), stone, style.trim, 0.5))
    if style.shutters:
        half = o.width / 2
        for left in (o.x - half - 0.03, x1 + 0.03):
            low, high = (left, -0.06, o.z), (left + half, -0.01, z1)
            parts.append(box(low, high, NUMBER["wood"], np.array(style.paint) * 1.6, 0.5))
    else:
        for left in (o.x - 0.14, x1):
            parts.append(box((left, -0.035, o.z), (left + 0.14, 0.0, z1), stone, style.trim, 0.5))
    return merge(parts)


def _door(rng: np.random.Generator, o: Opening, style: Style) -> Mesh:
    """Fill a hole with a panelled wooden door under a fanlight, and a doorstep."""
    z1 = o.z + o.height
    leaf = o.height * 0.78
    number, tint = NUMBER["wood"], np.array(style.paint) * rng.uniform(0.8, 1.5)
    parts = [reveal(o, "stone", style.trim)]
    parts.append(patch((o.x, RECESS_M, o.z), (o.width, 0, 0), (0, 0, leaf), number, tint))
    light = patch((o.x, RECESS_M, o.z + leaf), (o.width, 0, 0), (0, 0, o.height - leaf), NUMBER["glass"])
    parts.append(on_sheet(light, int(rng.integers(4)), int(rng.integers(4)), 4))
    y = RECESS_M - 0.05
    for x in (o.x, o.x + o.width / 2 - 0.05, o.x + o.width - 0.1):
        parts.append(box((x, y, o.z), (x + 0.1, RECESS_M, z1), number, tint * 0.85, 0.6))
    for z in (o.z, o.z + 0.35 * leaf, o.z + leaf - 0.05):
        parts.append(box((o.x, y + 0.02, z), (o.x + o.width, RECESS_M, z + 0.12), number, tint * 0.85, 0.6))
    for x in (o.x - 0.22, o.x + o.width):
        parts.append(box((x, -0.08, o.z), (x + 0.22, 0.0, z1), NUMBER["stone"], style.trim, 0.5))
    parts.append(
        box((o.x - 0.3, -0.14, z1), (o.x + o.width + 0.3, 0.0, z1 + 0.3), NUMBER["stone"], style.trim, 0.5)
    )
    parts.append(
        box((o.x - 0.1, -0.3, 0.0), (o.x + o.width + 0.1, RECESS_M, o.z), NUMBER["stone"], (1, 1, 1), 0.5)
    )
    return merge(parts)
