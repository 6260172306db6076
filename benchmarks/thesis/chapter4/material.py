"""What chapter 4 is measured on: a picture and its map of disparities."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.thesis.chapter import Task
from benchmarks.thesis.real_sets import PAIRS
from dvc.dibr.depth_image.depth_maps import default_hole, filled, read_depth_map
from dvc.dibr.depth_image.depth_scale import DepthScale, Plane
from dvc.dibr.depth_image.encoder import DepthImage
from dvc.errors import ConfigError, DvcError
from dvc.images.colour import Picture, luma
from dvc.picture_files import read_picture

THESIS_PEAKS = {"teddy": 53.0}
"""Of PSNRs of maps, in pixels, where the thesis has one."""

USUAL_SETS = ("teddy",)
MOTORCYCLE = "motorcycle"


@dataclass(frozen=True, eq=False)
class Material:
    """A map, with its picture or without."""

    name: str  # of the scene
    depth: Plane  # disparities or depth, holes filled
    peak: float  # of PSNRs, in the map's own units
    picture: Picture | None = None  # luma

    def __post_init__(self) -> None:
        if self.picture is not None and self.picture.shape != self.depth.shape:
            sizes = [f"{shape[1]}x{shape[0]}" for shape in (self.picture.shape, self.depth.shape)]
            raise ConfigError(f"{self.name}: a map of {sizes[1]} for a picture of {sizes[0]}")

    @property
    def image(self) -> DepthImage:
        """The map alone, as the encoder takes it."""
        return DepthImage(self.depth, DepthScale.of(self.depth))

    @property
    def num_pixels(self) -> int:
        """Of the map."""
        return self.depth.size

    def psnr_db(self, found: Plane) -> float:
        """Return how near a map is, all pixels counted."""
        mse = float(np.mean((found - self.depth) ** 2))
        return float(10.0 * np.log10(self.peak**2 / mse)) if mse else np.inf


def material_of_files(map_path: str | Path, image_path: str | Path | None = None) -> Material:
    """Read a map and its picture."""
    depth = read_depth_map(map_path, default_hole(map_path)).depth
    if not np.ptp(depth):
        raise DvcError(f"{map_path}: the map is constant")
    picture = None if image_path is None else luma(read_picture(image_path))
    return Material(Path(map_path).stem, depth, float(np.ptp(depth)), picture)


def material_of_set(name: str, data: Path) -> Material:
    """Read the reference view of a real set and its true disparities."""
    one = PAIRS[name]
    path = data / name / one.truth
    depth = read_depth_map(path, default_hole(path)).depth / one.scale
    peak = THESIS_PEAKS.get(name, float(np.ptp(depth)))
    return Material(name, depth, peak, luma(one.pair(data)[0].image))


def motorcycle() -> Material:
    """Return what scikit-image brings along."""
    from skimage.data import stereo_motorcycle

    try:
        left, _, disparity = stereo_motorcycle()
    except (OSError, ModuleNotFoundError, ValueError) as err:
        raise DvcError(f"the Motorcycle pair of scikit-image is not there: {err}") from err
    depth = filled(np.where(np.isfinite(disparity), disparity, np.nan).astype(np.float64))
    return Material(MOTORCYCLE, depth, float(np.ptp(depth)), luma(np.ascontiguousarray(left)))


def material_names(task: Task) -> Sequence[str]:
    """Return the maps of a task; files that are named make one."""
    if task.own:
        if len(task.chosen) > 2:
            raise ConfigError("chapter 4 measures a map, and its picture")
        return (material_of_files(*task.chosen).name,)
    for name in task.chosen:
        if name not in (MOTORCYCLE, *PAIRS):
            raise ConfigError(f"{name}: expected one of {', '.join((*PAIRS, MOTORCYCLE))}, or a map")
        if name != MOTORCYCLE and (task.data is None or not (task.data / name).is_dir()):
            raise ConfigError(f"{name}: --data must name a folder with {name} in it")
    return task.chosen or ((MOTORCYCLE,) if task.data is None else USUAL_SETS)


def load_material(name: str, task: Task) -> Material:
    """Load a map of a task."""
    if task.own:
        return material_of_files(*task.chosen)
    return motorcycle() if task.data is None or name == MOTORCYCLE else material_of_set(name, task.data)
