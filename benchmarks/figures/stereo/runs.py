"""Runs of `dvc-stereo reconstruct` as a user starts it, on the real sets and on the Motorcycle pair."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures.harness import MissingClip, Usage, run_module
from dvc.multiview.camera_array import LatticePosition
from dvc.pfm import read_pfm
from dvc.stereo.surfaces.folder import read_reconstruction
from dvc.stereo.surfaces.surface import Reconstruction
from dvc.stereo.thesis.real_sets import RealSet

DATA = Path("..") / "shared" / "stereo"
MOTORCYCLE = "motorcycle"
MOTORCYCLE_DISPARITIES = "0:64"
Picture = NDArray[np.uint8]
Floats = NDArray[np.float64]


def data_folder(name: str) -> Path:
    """Return the folder of the real sets."""
    if not (DATA / name).is_dir():
        raise MissingClip(f"not measured: no folder {DATA / name}")
    return DATA


@contextmanager
def reconstruction_folder(
    paths: Sequence[Path],
    disparities: str,
    positions: Sequence[LatticePosition] | None = None,
    options: Sequence[object] = (),
) -> Iterator[tuple[Path, Usage]]:
    """Reconstruct in a fresh process."""
    lattice = [] if positions is None else ["--lattice", *(f"{place.m:g},{place.n:g}" for place in positions)]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "surfaces"
        arguments = ["reconstruct", *paths, *lattice, f"--disparities={disparities}", "--out", folder]
        yield folder, run_module("dvc.stereo", [*arguments, "--quiet", *options])


def reference_disparity(
    one: RealSet, num_cameras: int | None = None, options: Sequence[object] = ()
) -> NDArray[np.float32]:
    """Reconstruct a real set with the default settings."""
    data = data_folder(one.name)
    files, positions = one.pair_files(data), None
    if num_cameras is not None:
        files, positions = one.array_files(data, num_cameras)
    with reconstruction_folder(files, one.disparities, positions, options) as (folder, _):
        return read_pfm(folder / f"disparity-{Path(one.reference).stem}.pfm")


def reconstructed(one: RealSet, num_cameras: int) -> Reconstruction:
    """Reconstruct all views of a real set with the default settings."""
    files, positions = one.array_files(data_folder(one.name), num_cameras)
    with reconstruction_folder(files, one.disparities, positions) as (folder, _):
        return read_reconstruction(folder)


def motorcycle(scale: float = 1.0) -> tuple[Picture, Picture, Floats]:
    """Return the pair that scikit-image carries."""
    from skimage.data import stereo_motorcycle

    left, right, disparity = stereo_motorcycle()
    truth = np.where(np.isfinite(disparity), disparity, np.nan).astype(np.float64)
    if scale == 1.0:
        return left, right, truth
    larger = [
        cv2.resize(view, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC) for view in (left, right)
    ]
    enlarged = cv2.resize(truth, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
    return (
        np.asarray(larger[0], np.uint8),
        np.asarray(larger[1], np.uint8),
        scale * np.asarray(enlarged, np.float64),
    )


def write_pair(folder: Path, left: Picture, right: Picture) -> list[Path]:
    """Write two views as PNG."""
    paths = [folder / "left.png", folder / "right.png"]
    for path, view in zip(paths, (left, right), strict=True):
        cv2.imwrite(str(path), view[:, :, ::-1])
    return paths
