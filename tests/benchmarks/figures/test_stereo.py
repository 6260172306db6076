"""Figures of stereo: how consistency is counted."""

import numpy as np

from benchmarks.figures.harness import Setting
from benchmarks.figures.stereo.consistency import agreement
from benchmarks.figures.stereo.identities import identities
from dvc.multiview.camera_array import DisparityLabels
from dvc.stereo.surfaces.surface import Reconstruction, Surface
from dvc.stereo.thesis.two_planes import FAR, NEAR, SIDE, two_planes


def made_up(change: float = 0.0) -> Reconstruction:
    """Return true surfaces of two planes, the last one off by a constant."""
    array, truth = two_planes()
    surfaces = [
        Surface(
            disparity.astype(np.float32), np.zeros(array.shape, np.bool_), np.ones(array.shape, np.float32)
        )
        for disparity in truth
    ]
    surfaces[2].disparity[...] += np.float32(change)
    return Reconstruction(array, DisparityLabels(0.0, 1.0, 13), tuple(surfaces))


def test_true_surfaces_agree() -> None:
    """All that is visible agrees; what the square hides does not count."""
    agreed, visible = agreement(made_up(), 0, 2)
    assert agreed == visible
    height, width = 60, 96
    hidden = SIDE * 2 * (NEAR - FAR)
    assert visible == height * (width - 2 * FAR) - hidden


def test_a_surface_too_far_back_does_not_agree() -> None:
    """Points before the other camera's surface are seen and contradict it."""
    agreed, visible = agreement(made_up(-3.0), 0, 2)
    assert agreed < 0.2 * visible


def test_identities_hold_on_random_rigs() -> None:
    """The figure is of the order of rounding."""
    found = identities(Setting(quick=True), "")
    assert found.holds
    assert 0.0 < found.values["points"] < 1e-12
