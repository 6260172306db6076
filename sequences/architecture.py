"""Buildings: facades with shop fronts, cornices and roofs round their windows and doors.

A facade is built in its own frame: x along the wall, y into the building, z up; turn and move it into place.
"""

import numpy as np

from sequences.meshes import Mesh, merge, patch
from sequences.openings import RECESS_M, Opening, Style, fill, frame, on_sheet, reveal, wall
from sequences.shapes import box, extrude
from sequences.textures import NUMBER


def shop(rng: np.random.Generator, width: float, height: float, style: Style) -> tuple[Mesh, list[Opening]]:
    """Make a shop front: large panes over a panelled base, a sign board, an awning."""
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
    """Build a house front with its sides and roof."""
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
    for kind in ("window", "door"):
        parts += [fill(rng, o, style) for o in openings if o.kind == kind]
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
