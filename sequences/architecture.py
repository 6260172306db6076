"""Buildings: facades with recessed windows, doors, shop fronts, cornices and roofs.

A facade is built in its own frame: x along the wall, y into the building, z up; turn and move it into place.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from sequences.meshes import Colour, Mesh, box, extrude, merge, patch
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
    """Look of a facade.

    Parameters
    ----------
    material : str
        Texture of the wall.
    tint : tuple of float
        Its colour.
    trim : tuple of float
        Colour of cornices, sills and surrounds.
    paint : tuple of float
        Colour of window frames and doors.
    ground : str
        ``"shop"``, ``"door"`` or ``"plain"``.
    shutters : bool
        Whether windows have them.
    """

    material: str
    tint: Colour
    trim: Colour = (0.95, 0.92, 0.85)
    paint: Colour = PAINTS[0]
    ground: str = "door"
    shutters: bool = False


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


def window(rng: np.random.Generator, o: Opening, style: Style) -> Mesh:
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


def door(rng: np.random.Generator, o: Opening, style: Style) -> Mesh:
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


def shop(rng: np.random.Generator, width: float, height: float, style: Style) -> tuple[Mesh, list[Opening]]:
    """Make a shop front: large panes over a panelled base, a sign board, an awning.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    width, height : float
        Of the ground floor, metres.
    style : Style
        Look of the facade.

    Returns
    -------
    mesh : Mesh
        All but the wall.
    openings : list of Opening
        Holes for the wall.
    """
    count = max(2, int(width / 2.3))
    pitch = (width - 0.6) / count
    tint = np.array([rng.uniform(0.08, 0.6), rng.uniform(0.1, 0.4), rng.uniform(0.08, 0.4)])
    parts, openings = [], []
    for k in range(count):
        o = Opening(0.3 + k * pitch + 0.15, 0.5, pitch - 0.3, height - 1.35, "pane")
        openings.append(o)
        picture = rng.choice(["glass", "coffee", "rocket", "glass"])
        pane = patch(
            (o.x, RECESS_M, o.z), (o.width, 0, 0), (0, 0, o.height), NUMBER[str(picture)], (1, 1, 1), 0.7
        )
        sheet = (int(rng.integers(4)), int(rng.integers(4)), 4) if picture == "glass" else (0, 0, 1)
        parts += [
            on_sheet(pane, *sheet).tinted((0.75, 0.8, 0.8)),
            reveal(o, "paint", tint),
            frame(o, (2, 1), tint),
        ]
    parts.append(
        box((0.2, -0.12, height - 0.75), (width - 0.2, 0.0, height - 0.15), NUMBER["paint"], tint * 1.2)
    )
    for x in np.arange(0.9, width - 1.2, 0.36):
        letter = rng.uniform(0.1, 0.24), rng.uniform(0.22, 0.32)
        low = (x, -0.14, height - 0.6)
        if rng.random() < 0.85:
            parts.append(
                box(low, (x + letter[0], -0.12, low[2] + letter[1]), NUMBER["paint"], (1.4, 1.3, 1.0), 0.5)
            )
    if rng.random() < 0.7:
        stripes = max(6, int(width / 0.45))
        for k in range(stripes):
            x = 0.25 + k * (width - 0.5) / stripes
            colour = (1.3, 1.25, 1.15) if k % 2 else tuple(tint * 1.6)
            step = ((width - 0.5) / stripes, 0, 0)
            parts.append(patch((x, -1.15, height - 1.25), step, (0, 1.05, 0.5), NUMBER["paint"], colour, 0.4))
            parts.append(patch((x, -1.15, height - 1.45), step, (0, 0, 0.2), NUMBER["paint"], colour, 0.4))
    return merge(parts), openings


def facade(rng: np.random.Generator, width: float, floors: int, style: Style, depth: float = 7.0) -> Mesh:
    """Build a house front with its sides and roof.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness: window contents, doors, roofs.
    width : float
        Along the wall, metres.
    floors : int
        Storeys, the ground floor included.
    style : Style
        Look.
    depth : float
        Of the building, metres.

    Returns
    -------
    Mesh
        In the frame of the facade, standing on z = 0.
    """
    ground, storey = 3.4, 3.0
    top = ground + storey * (floors - 1)
    bays = max(2, round(width / 2.3))
    openings, parts = [], []
    if style.ground == "shop":
        front, panes = shop(rng, width, ground, style)
        parts.append(front)
        openings += panes
    for floor in range(floors):
        for bay in range(bays):
            middle = width * (bay + 0.5) / bays
            if floor > 0:
                tall = 1.75 if floor < floors - 1 or floors < 3 else 1.35
                openings.append(Opening(middle - 0.5, ground + storey * (floor - 1) + 0.75, 1.0, tall))
            elif style.ground == "door" and bay == bays // 2:
                openings.append(Opening(middle - 0.6, 0.15, 1.2, 2.65, "door"))
            elif style.ground != "shop":
                openings.append(Opening(middle - 0.55, 1.0, 1.1, 1.7))
    parts += [window(rng, o, style) for o in openings if o.kind == "window"]
    parts += [door(rng, o, style) for o in openings if o.kind == "door"]
    parts.append(wall(width, 0.0, top, openings, style.material, style.tint))
    parts.append(_trimmings(width, ground, top, style))
    parts.append(_roof(rng, width, top, depth, style))
    return weathered(merge(parts))


def _trimmings(width: float, ground: float, top: float, style: Style) -> Mesh:
    number = NUMBER["stone"]
    cornice = [
        (0.05, 0.1),
        (0.45, 0.08),
        (0.45, -0.05),
        (0.3, -0.12),
        (0.2, -0.28),
        (0.06, -0.34),
        (0.06, -0.45),
        (0, -0.45),
    ]
    course = [(0.0, 0.12), (0.1, 0.1), (0.1, 0.0), (0.05, -0.1), (0.0, -0.1)]
    plinth = [(0.0, 0.62), (0.06, 0.58), (0.06, 0.0)]
    parts = [extrude(cornice, (0, 0, top), (width, 0, top), number, style.trim)]
    parts.append(extrude(course, (0, 0, ground), (width, 0, ground), number, style.trim))
    if style.ground != "shop":
        for left, right in ((0.0, width / 2 - 1.0), (width / 2 + 1.0, width)):
            parts.append(extrude(plinth, (left, 0, 0), (right, 0, 0), number, np.array(style.trim) * 0.75))
    parts.append(
        box(
            (width - 0.16, -0.1, 0.2), (width - 0.06, 0.0, top - 0.4), NUMBER["paint"], (0.3, 0.32, 0.33), 0.6
        )
    )
    return merge(parts)


def _roof(rng: np.random.Generator, width: float, top: float, depth: float, style: Style) -> Mesh:
    number, rise = NUMBER["tiles"], rng.uniform(1.8, 2.8)
    side = np.array(style.tint) * 0.9
    parts = [patch((0, 0.1, top + 0.1), (width, 0, 0), (0, depth / 2, rise), number, (1, 1, 1), 0.8)]
    parts.append(patch((0, depth, 0), (0, -depth, 0), (0, 0, top + 0.1), NUMBER[style.material], side, 0.8))
    parts.append(patch((width, 0, 0), (0, depth, 0), (0, 0, top + 0.1), NUMBER[style.material], side, 0.8))
    for _ in range(2):
        x, high = rng.uniform(0.6, width - 1.4), top + rise + rng.uniform(0.4, 1.0)
        parts.append(box((x, 1.6, top + 0.4), (x + 0.8, 2.3, high), NUMBER["brick"], (0.8, 0.8, 0.8), 0.6))
    return merge(parts)


def weathered(mesh: Mesh, splash_m: float = 0.5) -> Mesh:
    """Darken a building towards the ground, where rain throws dirt up."""
    return mesh.tinted((1.0 - 0.38 * np.exp(-np.maximum(mesh.points[:, 2], 0.0) / splash_m))[:, None])
