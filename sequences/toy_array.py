"""*toy*: objects on a floor before a wall, seen by two rows of two cameras; their axes are not parallel."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvc.files import atomic_folder
from dvc.pfm import write_pfm
from sequences.rendered_scenes import Description, scene
from sequences.renderer import render_picture
from sequences.scene_cameras import Camera, look_at
from sequences.scenery import column
from sequences.shapes import Look, Mesh, box, lathe, merge, patch

Floats = NDArray[np.float64]

POSITIONS = ((0, 0), (1, 0), (0, 1), (1, 1))
"""Positions (m, n) of the cameras: m to the right, n downwards."""
STEP_RIGHT_M, STEP_DOWN_M = 0.24, 0.17
_UPPER_LEFT = np.array([-0.12, 0.0, 1.32])
_TURNS_DEG = ((0.8, -1.5, 1.2), (-0.6, 1.1, -0.8), (1.2, 0.7, -1.6), (-1.0, -0.9, 0.9))


def _pose(index: float, seed: int) -> Floats:
    """Return the camera of a position; all look roughly at the middle of the scene."""
    del seed
    m, n = POSITIONS[int(index)]
    eye = _UPPER_LEFT + np.array([m * STEP_RIGHT_M, 0.0, -n * STEP_DOWN_M])
    target = eye + np.array([0.05 - 0.12 * m, 4.0, -0.35 + 0.1 * n])
    return look_at(eye, target, _TURNS_DEG[int(index)])


def _geometry(rng: np.random.Generator) -> Mesh:
    """Build the room; nothing in it is random."""
    del rng
    vase = [(0.10, 0.0), (0.20, 0.12), (0.24, 0.3), (0.20, 0.48), (0.10, 0.6), (0.09, 0.68), (0.13, 0.74)]
    tower = box((-0.2, -0.18, 0.0), (0.2, 0.17, 0.72), Look("print", (0.12, 0.3, 0.5))).turned(12.0)
    parts = [
        patch((-6, -1, 0), (12, 0, 0), (0, 9.0, 0), Look("wood", (0.36, 0.22, 0.12))),
        patch((-6, 6.0, 0), (12, 0.8, 0), (0, 0, 6), Look("brick", (0.36, 0.16, 0.1))),
        box((-1.35, 3.3, 0.0), (-0.55, 3.9, 1.05), Look("print", (0.5, 0.3, 0.12))),
        tower.moved((-0.05, 2.72, 0.0)),
        box((0.55, 4.4, 0.0), (1.45, 5.0, 1.55), Look("ashlar", (0.46, 0.41, 0.33))).turned(-6.0),
        box((-0.6, 5.0, 0.0), (0.3, 5.3, 1.9), Look("tiles", (0.3, 0.13, 0.08))),
        column((-0.35, 3.75, 0.0), 1.5, 0.13),
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
    pose=_pose,
    geometry=_geometry,
    sun_deg=(-35.0, 62.0),
    shadows=((0.0, 3.5, 1.0), 6.0),
)


@dataclass(frozen=True, eq=False)
class RenderedView:
    """A picture of an array with its true depth and camera."""

    position: tuple[int, int]  # (m, n) of its camera
    image: NDArray[np.uint8]  # red, green, blue
    depth: NDArray[np.float32]  # along the optical axis, metres
    camera: Camera

    @property
    def stem(self) -> str:
        """Name of its files, without suffix."""
        return "toy-{}-{}".format(*self.position)


def render_view(name: str, index: int, width: int = 320, height: int = 240, *, seed: int = 0) -> RenderedView:
    """Render one view of an array."""
    image, depth, camera = render_picture(scene(name, seed), index, width, height)
    return RenderedView(POSITIONS[index], image, depth, camera)


def write_array(
    name: str,
    folder: str | Path,
    width: int = 320,
    height: int = 240,
    *,
    seed: int = 0,
    progress: Callable[[int], None] = lambda _: None,
) -> None:
    """Write all views of an array: pictures, depth, `cameras.json` and `views.csv`."""
    import cv2

    cameras, rows = [], ["file,m,n"]
    with atomic_folder(folder) as made:
        for index in range(len(POSITIONS)):
            view = render_view(name, index, width, height, seed=seed)
            content = cv2.imencode(".png", view.image[:, :, ::-1])[1]
            (made / f"{view.stem}.png").write_bytes(content.tobytes())
            write_pfm(made / f"depth-{view.stem}.pfm", view.depth)
            pose = view.camera.cam_from_world
            entry = {"file": f"{view.stem}.png", "K": view.camera.K.tolist()}
            cameras.append({**entry, "R": pose[:, :3].tolist(), "t": pose[:, 3].tolist()})
            rows.append("{}.png,{},{}".format(view.stem, *view.position))
            progress(1)
        (made / "cameras.json").write_text(json.dumps(cameras, indent=1) + "\n", encoding="utf-8")
        (made / "views.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
