"""The comparison of surfaces: counted pixels, and temporary settings."""

from contextlib import ExitStack

import numpy as np
import pytest

from benchmarks.searches.surfaces import TEST_PAIRS, TUNING_PAIRS, Pair, changed
from dvc.geometry.camera_array import ArrayView, CameraArray, LatticePosition
from dvc.stereo.surfaces import surface_completion


def test_bad_pixels_are_shares_of_what_counts() -> None:
    image = np.zeros((4, 10, 3), np.uint8)
    views = (
        ArrayView("left", image, LatticePosition(0.0, 0.0)),
        ArrayView("right", image, LatticePosition(1.0, 0.0)),
    )
    truth = np.full((4, 10), 5.0)
    everywhere, seen = np.ones((4, 10), bool), np.ones((4, 10), bool)
    seen[:, 5:] = False
    found = truth.copy()
    found[:, 0] += 0.75
    found[:, 9] += 2.0
    pair = Pair(CameraArray(views), truth, (everywhere, seen))
    assert pair.bad_percent(found) == pytest.approx([10.0, 0.0, 20.0, 20.0])


def test_settings_are_changed_for_a_while() -> None:
    """Fields of the settings by their names, constants by their full names, nothing else."""
    before = surface_completion.PLANE_LEVELS
    with ExitStack() as stack:
        settings = changed(
            ["sub_pixel=True", "dvc.stereo.surfaces.surface_completion.PLANE_LEVELS=0.7"], stack
        )
        assert settings.sub_pixel
        assert surface_completion.PLANE_LEVELS == 0.7
    assert before == surface_completion.PLANE_LEVELS


def test_pairs_are_apart() -> None:
    assert not set(TUNING_PAIRS) & set(TEST_PAIRS)
    assert len([name for name in TEST_PAIRS if name.endswith("_Q")]) == 2
