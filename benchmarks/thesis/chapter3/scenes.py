"""What the chapter is measured on: real sets in a folder, material that needs none, or views of a user."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.thesis.chapter import Task
from benchmarks.thesis.real_sets import PAIRS
from dvc.array_files import load_array, parse_disparities, read_positions
from dvc.dibr.views.views import Views, views_of_array
from dvc.errors import ConfigError, DvcError
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition

TSUKUBA_BORDER_PX = 2
"""Artefacts of the camera, removed as in the thesis."""
MOTORCYCLE_DISPARITIES = "0:64"
CGTOY_DISPARITIES = "-15:9:0.5"


@dataclass(frozen=True, eq=False)
class Scene:
    """Views of a scene, the reference first."""

    name: str  # of the scene
    array: CameraArray  # rectified views in colour; the first is the reference
    labels: DisparityLabels  # disparities to choose from

    @property
    def views(self) -> Views:
        """All views, gray as in the chapter."""
        return views_of_array(self.array, gray=True)

    @property
    def pair(self) -> CameraArray:
        """Reference and the view at (1, 0) from it, or else the nearest one to its right, or any."""
        own = self.array[0].position

        def _away(view: ArrayView) -> tuple[bool, float]:
            m, n = view.position.m - own.m, view.position.n - own.n
            return (m <= 0.0 or n != 0.0), abs(m - 1.0) + abs(n)

        return CameraArray((self.array[0], min(self.array.views[1:], key=_away)))


def scene_of_array(name: str, array: CameraArray, labels: DisparityLabels) -> Scene:
    """Make a scene of views in any order."""
    first = array.reference
    others = (view for index, view in enumerate(array) if index != first)
    return Scene(name, CameraArray((array[first], *others)), labels)


def _pair(name: str, data: Path) -> Scene:
    one = PAIRS[name]
    return scene_of_array(name, one.pair(data), one.labels)


def _cones(data: Path) -> Scene:
    one = PAIRS["cones"]
    return scene_of_array(one.name, one.array(data, 9), one.labels)


def _tsukuba(data: Path) -> Scene:
    """Read the nine views around the reference, without their border."""
    one, inner = PAIRS["tsukuba"], slice(TSUKUBA_BORDER_PX, -TSUKUBA_BORDER_PX)
    views = [
        replace(view, image=np.ascontiguousarray(view.image[inner, inner]))
        for view in one.array(data, 25)
        if max(abs(view.position.m), abs(view.position.n)) <= 1.0
    ]
    return scene_of_array(one.name, CameraArray(tuple(views)), one.labels)


def _cgtoy(data: Path) -> Scene:
    positions = read_positions(data / "cgtoy" / "views.csv")
    paths = [data / "cgtoy" / file for file in positions]
    array = load_array(paths, list(positions.values()))
    return scene_of_array("cgtoy", array, parse_disparities(CGTOY_DISPARITIES))


REAL_SCENES: dict[str, Callable[[Path], Scene]] = {
    "teddy": lambda data: _pair("teddy", data),
    "tsukuba": _tsukuba,
    "cones": _cones,
    "venus": lambda data: _pair("venus", data),
    "cgtoy": _cgtoy,
}
"""By the folder of their files."""
USUAL_SCENES, QUICK_SCENES = ("teddy", "tsukuba", "cones", "cgtoy"), ("teddy", "tsukuba")
OWN = "views"
"""Name of the views of a user."""


def toy() -> Scene:
    """Render the array of two by two cameras, and rectify it."""
    from benchmarks.thesis.toy import rectified_toy

    rectified = rectified_toy()
    if rectified.labels is None:
        raise DvcError("toy: no disparities were found")
    return scene_of_array("toy", everywhere_valid(rectified.array), rectified.labels)


def everywhere_valid(array: CameraArray) -> CameraArray:
    """Crop rectified views to a common frame in which every camera has seen something."""
    seen = np.logical_and.reduce([view.seen for view in array])
    top, left, (bottom, right) = 0, 0, seen.shape
    while not (inner := seen[top:bottom, left:right]).all():
        sides = [float(np.mean(~line)) for line in (inner[0], inner[-1], inner[:, 0], inner[:, -1])]
        side = sides.index(max(sides))
        top, bottom = top + (side == 0), bottom - (side == 1)
        left, right = left + (side == 2), right - (side == 3)
    cut = slice(top, bottom), slice(left, right)
    views = [replace(view, image=np.ascontiguousarray(view.image[cut]), valid=None) for view in array]
    return CameraArray(tuple(views))


def motorcycle() -> Scene:
    """Return the pair that scikit-image brings along."""
    from skimage.data import stereo_motorcycle

    try:
        left, right, _ = stereo_motorcycle()
    except (OSError, ModuleNotFoundError, ValueError) as err:
        raise DvcError(f"the Motorcycle pair of scikit-image is not there: {err}") from err
    views = [
        ArrayView(name, np.ascontiguousarray(view), LatticePosition(float(m), 0.0))
        for m, (name, view) in enumerate((("left", left), ("right", right)))
    ]
    return Scene("motorcycle", CameraArray(tuple(views)), parse_disparities(MOTORCYCLE_DISPARITIES))


FREE_SCENES: Mapping[str, Callable[[], Scene]] = {"toy": toy, "motorcycle": motorcycle}
"""Those that need no data."""


def scene_names(task: Task) -> Sequence[str]:
    """Return the scenes of a task; files that are named make one."""
    if not task.chosen:
        return tuple(FREE_SCENES) if task.data is None else USUAL_SCENES if task.full else QUICK_SCENES
    if task.own:
        if task.disparities is None:
            raise ConfigError("own views need --disparities MIN:MAX, in pixels per unit of m")
        return (OWN,)
    for name in task.chosen:
        if name not in FREE_SCENES and name not in REAL_SCENES:
            known = ", ".join((*REAL_SCENES, *FREE_SCENES))
            raise ConfigError(f"{name}: expected one of {known}, or own views")
        if name in REAL_SCENES and (task.data is None or not (task.data / name).is_dir()):
            raise ConfigError(f"{name}: --data must name a folder with {name} in it")
    return task.chosen


def load_scene(name: str, task: Task) -> Scene:
    """Load a scene of a task."""
    if name == OWN:
        return Scene(OWN, load_array(task.chosen, None), parse_disparities(task.disparities or ""))
    return FREE_SCENES[name]() if name in FREE_SCENES else REAL_SCENES[name](task.data or Path())
