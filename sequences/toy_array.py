"""Pictures of a rendered camera array, with exact depth and cameras."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.files import atomic_folder
from dvc.picture_files import write_pfm
from sequences.rendered_scenes import scene
from sequences.renderer import render_picture
from sequences.scene_cameras import Camera
from sequences.scene_layouts import POSITIONS


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
