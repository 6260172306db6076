"""Fusion of surfaces: medians of cameras that agree, what most look through, and what stays."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.stereo.surfaces import surface_completion
from dvc.stereo.surfaces.occupancy import shifts
from dvc.stereo.surfaces.surface_completion import fused
from tests.reference import stereo_volumes as volumes
from tests.stereo.plane_scenes import BACKGROUND, LABELS, SCENE, reconstruction_of, square_lattice

FEW = DisparityLabels(0.0, 1.0, 7)
CROSS = [(0.0, 0.0), (-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)]


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a fresh generator."""
    return np.random.default_rng(2150)


@pytest.mark.nojit
@pytest.mark.parametrize("choose", [lambda kernel: kernel, python_twin], ids=["compiled", "python"])
@pytest.mark.parametrize("tolerance", [1, 2])
def test_kernel_is_its_twin(choose: Callable[[Any], Any], rng: np.random.Generator, tolerance: int) -> None:
    """Whole labels and values between them, with places where cameras have seen nothing."""
    far = np.where(rng.random((5, 9, 11)) < 0.6, 1.0, rng.integers(0, 7, (5, 9, 11)))
    maps = np.clip(far + 0.25 * rng.integers(-1, 2, far.shape), 0.0, 6.0)
    seen = rng.random(maps.shape) < 0.9
    moved = np.stack([shifts(FEW, LatticePosition(0.0, 0.0), LatticePosition(*place)) for place in CROSS])
    found = np.empty(maps.shape[1:])
    choose(surface_completion._fuse)(0, maps, seen, moved, tolerance, found)
    np.testing.assert_array_equal(found, volumes.fused(0, maps, seen, moved, tolerance))
    refuted = found < maps[0] - tolerance
    assert refuted.any()
    assert (found[~refuted] != maps[0][~refuted]).any()


def test_surfaces_that_agree_stay() -> None:
    """True surfaces are what all cameras see: nothing changes, also beside discontinuities."""
    scene = reconstruction_of(SCENE, square_lattice(1), LABELS)
    maps = [LABELS.label(surface.disparity).astype(np.float64) for surface in scene.surfaces]
    for index, label in enumerate(maps):
        np.testing.assert_array_equal(fused(scene.array, LABELS, maps, index), label)


def test_what_one_camera_alone_has_wrong_is_put_right(rng: np.random.Generator) -> None:
    """A patch before the true surface, and noise of a label, are gone where others look."""
    scene = reconstruction_of([BACKGROUND], CROSS, LABELS)
    true = [LABELS.label(surface.disparity).astype(np.float64) for surface in scene.surfaces]
    maps = [label + (rng.random(label.shape) < 0.1) for label in true]
    maps[0][20:28, 20:30] = LABELS.num_labels - 1.0
    for _ in range(2):
        maps = [fused(scene.array, LABELS, maps, index) for index in range(len(maps))]
    inner = np.s_[12:-12, 12:-12]
    assert (maps[0][inner] == true[0][inner]).mean() > 0.98
    assert (maps[0][20:28, 20:30] <= true[0][20:28, 20:30] + 1.0).all()


def test_two_cameras_decide_nothing(rng: np.random.Generator) -> None:
    """There is no majority of two."""
    scene = reconstruction_of(SCENE, square_lattice(1)[:2], LABELS)
    maps = [rng.integers(0, LABELS.num_labels, scene.array.shape).astype(np.float64) for _ in range(2)]
    np.testing.assert_array_equal(fused(scene.array, LABELS, maps, 0), maps[0])
