"""Real camera arrays with true disparities: which files a folder of them has, and how they are evaluated."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dvc.array_files import load_array, parse_disparities, read_positions
from dvc.errors import ConfigError
from dvc.geometry.camera_array import CameraArray, DisparityLabels, LatticePosition
from dvc.stereo.evaluation import MASKS, Evaluation, evaluate, read_mask, read_truth


@dataclass(frozen=True)
class RealSet:
    """A set of views in a folder of its name."""

    name: str  # of the folder
    reference: str  # file of the view whose truth is known
    right: str  # file of the right view of the pair
    disparities: str  # range as commands take it
    truth: str  # file of the true disparities
    scale: float = 1.0  # disparity is value / scale

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
            file: place
            for file, place in table.items()
            if (num_cameras not in (2, 5))
            or ((abs(place.m) + abs(place.n)) <= step and (num_cameras == 5 or place.m >= place.n == 0.0))
        }
        if len(chosen) != num_cameras:
            raise ConfigError(f"{data / self.name}: {len(chosen)} views where {num_cameras} are needed")
        return [data / self.name / file for file in chosen], list(chosen.values())

    def pair(self, data: Path) -> CameraArray:
        """Read the pair, whose left view is at (0, 0) and whose right one is at (1, 0)."""
        return load_array(self.pair_files(data), None)

    def array(self, data: Path, num_cameras: int) -> CameraArray:
        """Read cameras around the reference, as `array_files` chooses them."""
        return load_array(*self.array_files(data, num_cameras))

    def true_disparity(self, data: Path) -> NDArray[np.float64]:
        """Read the truth of the reference view."""
        return read_truth(data / self.name / self.truth, self.scale)

    def evaluate(
        self, data: Path, disparity: NDArray[np.floating], thresholds: Sequence[float] = (1.0,)
    ) -> dict[str, Evaluation]:
        """Evaluate disparities of the reference view with every mask there is."""
        truth = self.true_disparity(data)
        paths = {name: data / self.name / f"{name}.png" for name in MASKS}
        masks = {name: read_mask(path) if path.exists() else None for name, path in paths.items()}
        known = {name: mask for name, mask in masks.items() if mask is not None or name == "all"}
        return {name: evaluate(disparity, truth, mask, thresholds) for name, mask in known.items()}


PAIRS = {
    one.name: one
    for one in (
        RealSet(
            "tsukuba", "scene1.row3.col3.png", "scene1.row3.col4.png", "0:15", "truedisp.row3.col3.png", 16.0
        ),
        RealSet("venus", "im2.png", "im6.png", "0:20", "disp2.png", 8.0),
        RealSet("teddy", "im2.png", "im6.png", "0:59", "disp2.png", 4.0),
        RealSet("cones", "im2.png", "im6.png", "0:59", "disp2.png", 4.0),
    )
}
"""The four sets of the Middlebury evaluation, version 2."""
TSUKUBA = PAIRS["tsukuba"]


def check_sets(data: Path, names: Sequence[str]) -> None:
    """Refuse a folder without some of the sets."""
    missing = [name for name in names if not (data / name).is_dir()]
    if missing:
        raise ConfigError(f"{data}: expected the folders {', '.join(names)}; there is no {missing[0]}")
