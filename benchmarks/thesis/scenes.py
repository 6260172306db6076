"""Scenes that chapters are measured on: real sets in a folder, a rendered array, and the Motorcycle pair."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.array_files import load_array, parse_disparities, read_positions
from dvc.dibr.view_set import Views, views_of_array
from dvc.environment import python_module
from dvc.errors import ConfigError, DvcError
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, LatticePosition
from dvc.rd.child_processes import ProcessGroup
from dvc.stereo.evaluation import Evaluation, evaluate, read_mask, read_truth
from dvc.stereo.rectification.rectified_array import RectifiedArray, rectified_array

MOTORCYCLE = "motorcycle"
MOTORCYCLE_DISPARITIES, CGTOY_DISPARITIES = "0:64", "-15:9:0.5"
TSUKUBA_BORDER_PX = 2
"""Width of the border with artefacts of the camera, which is removed as in the thesis."""
MASKS = ("nonocc", "all", "disc")
"""Masks of the Middlebury evaluation: pixels that both views see, with known truth, near discontinuities."""


@dataclass(frozen=True)
class RealSet:
    """A set of views in a folder of its name, with the true disparities of one of them."""

    name: str
    reference: str  # file of the view with a truth
    right: str  # file of the right view of the pair
    disparities: str  # range as commands take it
    truth: str  # file of the true disparities
    scale: float = 1.0  # value of the truth for a disparity of 1

    @property
    def labels(self) -> DisparityLabels:
        """Disparities to try."""
        return parse_disparities(self.disparities)

    def pair_files(self, data: Path) -> list[Path]:
        """Return the files of the left and the right view."""
        return [data / self.name / self.reference, data / self.name / self.right]

    def array_files(self, data: Path, num_cameras: int) -> tuple[list[Path], list[LatticePosition]]:
        """Return files and positions of cameras around the reference."""
        table = read_positions(data / self.name / "views.csv")
        step = min(position.m for position in table.values() if position.m > 0.0)
        chosen = {
            file: position
            for file, position in table.items()
            if (num_cameras not in (2, 5))
            or (
                (abs(position.m) + abs(position.n)) <= step
                and (num_cameras == 5 or position.m >= position.n == 0.0)
            )
        }
        if len(chosen) != num_cameras:
            raise ConfigError(f"{data / self.name}: expected {num_cameras} views, got {len(chosen)}")
        return [data / self.name / file for file in chosen], list(chosen.values())

    def pair(self, data: Path) -> CameraArray:
        """Read the pair: the left view at (0, 0) and the right one at (1, 0)."""
        return load_array(self.pair_files(data), None)

    def array(self, data: Path, num_cameras: int) -> CameraArray:
        """Read cameras around the reference."""
        return load_array(*self.array_files(data, num_cameras))

    def true_disparity(self, data: Path) -> NDArray[np.float64]:
        """Read the truth of the reference view."""
        return read_truth(data / self.name / self.truth, self.scale)

    def evaluate(
        self, data: Path, disparity: NDArray[np.floating], thresholds: Sequence[float] = (1.0,)
    ) -> dict[str, Evaluation]:
        """Evaluate disparities of the reference view by all pixels and by every mask of the folder."""
        truth, found = self.true_disparity(data), {}
        for name in MASKS:
            path = data / self.name / f"{name}.png"
            mask = read_mask(path) if path.exists() else None
            if mask is not None or name == "all":
                found[name] = evaluate(disparity, truth, mask, thresholds)
        return found


PAIRS = {
    one.name: one
    for one in (
        RealSet(
            "tsukuba", "scene1.row3.col3.png", "scene1.row3.col4.png", "0:15", "truedisp.row3.col3.png", 16
        ),
        RealSet("venus", "im2.png", "im6.png", "0:20", "disp2.png", 8),
        RealSet("teddy", "im2.png", "im6.png", "0:59", "disp2.png", 4),
        RealSet("cones", "im2.png", "im6.png", "0:59", "disp2.png", 4),
    )
}
"""The four sets of the Middlebury evaluation, version 2."""
TSUKUBA = PAIRS["tsukuba"]


@dataclass(frozen=True, eq=False)
class Scene:
    """Views of a scene in colour, the reference first, and the disparities to choose from."""

    array: CameraArray
    labels: DisparityLabels

    @property
    def views(self) -> Views:
        """All views in gray, as chapter 3 codes them."""
        return views_of_array(self.array, gray=True)

    @property
    def pair(self) -> CameraArray:
        """The reference and one more view: at (1, 0) from it, else the nearest to its right, else any."""
        reference = self.array[0].position

        def _distance(view: ArrayView) -> tuple[bool, float]:
            m, n = view.position.m - reference.m, view.position.n - reference.n
            return (m <= 0.0 or n != 0.0), abs(m - 1.0) + abs(n)

        return CameraArray((self.array[0], min(self.array.views[1:], key=_distance)))


def scene_of_array(array: CameraArray, labels: DisparityLabels) -> Scene:
    """Make a scene of views in any order."""
    first = array.reference
    rest = (view for index, view in enumerate(array) if index != first)
    return Scene(CameraArray((array[first], *rest)), labels)


def rectified_toy() -> tuple[RectifiedArray, DisparityLabels]:
    """Render the array of two by two cameras in a process of its own, and rectify it by its cameras."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "toy"
        ProcessGroup().run(python_module("sequences", "render", "toy", "--out", folder))
        rectified = rectified_array(sorted(folder.glob("toy-*.png")), folder / "cameras.json")
    if rectified.labels is None:
        raise DvcError("toy: rectification gives no range of disparities")
    return rectified, rectified.labels


def everywhere_valid(array: CameraArray) -> CameraArray:
    """Crop rectified views to a common frame without pixels that some camera has not seen."""
    seen = np.logical_and.reduce([view.seen for view in array])
    top, left, (bottom, right) = 0, 0, seen.shape
    while not (inner := seen[top:bottom, left:right]).all():
        sides = [float(np.mean(~line)) for line in (inner[0], inner[-1], inner[:, 0], inner[:, -1])]
        side = sides.index(max(sides))
        top, bottom = top + (side == 0), bottom - (side == 1)
        left, right = left + (side == 2), right - (side == 3)
    return _cropped(array.views, slice(top, bottom), slice(left, right))


def _cropped(views: Sequence[ArrayView], rows: slice, columns: slice) -> CameraArray:
    cut = [np.ascontiguousarray(view.image[rows, columns]) for view in views]
    return CameraArray(
        tuple(replace(view, image=image, valid=None) for view, image in zip(views, cut, strict=True))
    )


def motorcycle_files() -> tuple[Any, Any, Any]:
    """Return left view, right view and disparities of the Motorcycle pair of scikit-image."""
    from skimage.data import stereo_motorcycle

    try:
        left, right, disparity = stereo_motorcycle()
    except (OSError, ModuleNotFoundError, ValueError) as err:
        raise DvcError(f"the Motorcycle pair of scikit-image cannot be read: {err}") from err
    return np.ascontiguousarray(left), np.ascontiguousarray(right), disparity


def _toy(_: Path) -> Scene:
    rectified, labels = rectified_toy()
    return scene_of_array(everywhere_valid(rectified.array), labels)


def _motorcycle(_: Path) -> Scene:
    left, right, _disparity = motorcycle_files()
    views = (
        ArrayView("left", left, LatticePosition(0.0, 0.0)),
        ArrayView("right", right, LatticePosition(1.0, 0.0)),
    )
    return Scene(CameraArray(views), parse_disparities(MOTORCYCLE_DISPARITIES))


def _pair(name: str, data: Path) -> Scene:
    return scene_of_array(PAIRS[name].pair(data), PAIRS[name].labels)


def _tsukuba(data: Path) -> Scene:
    """Read the nine views around the reference, without their border."""
    inner = slice(TSUKUBA_BORDER_PX, -TSUKUBA_BORDER_PX)
    views = [
        view for view in TSUKUBA.array(data, 25) if max(abs(view.position.m), abs(view.position.n)) <= 1.0
    ]
    return scene_of_array(_cropped(views, inner, inner), TSUKUBA.labels)


def _cgtoy(data: Path) -> Scene:
    positions = read_positions(data / "cgtoy" / "views.csv")
    array = load_array([data / "cgtoy" / file for file in positions], list(positions.values()))
    return scene_of_array(array, parse_disparities(CGTOY_DISPARITIES))


FREE_SCENES: Mapping[str, Callable[[Path], Scene]] = {"toy": _toy, MOTORCYCLE: _motorcycle}
"""Scenes that need no data."""
REAL_SCENES: Mapping[str, Callable[[Path], Scene]] = {
    "teddy": partial(_pair, "teddy"),
    "tsukuba": _tsukuba,
    "cones": lambda data: scene_of_array(PAIRS["cones"].array(data, 9), PAIRS["cones"].labels),
    "venus": partial(_pair, "venus"),
    "cgtoy": _cgtoy,
}
"""Scenes by the folder of their files."""


def check_names(
    names: Sequence[str], data: Path | None, real: Sequence[str], free: Sequence[str], files: str
) -> None:
    """Refuse names that are unknown, and real sets without a folder."""
    for name in names:
        if name not in (*real, *free):
            raise ConfigError(f"{name}: expected one of {', '.join((*real, *free))}{files}")
        if name in real and (data is None or not (data / name).is_dir()):
            raise ConfigError(f"{name}: --data must name a folder with {name} in it")
