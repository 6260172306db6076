"""Planes through labels: a plain twin, and slanted surfaces that labels show in steps."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dvc.stereo.surfaces import surface_completion as completion
from dvc.stereo.surfaces.surface_completion import fitted_planes

Floats = NDArray[np.float64]


def plain(label: Floats, supported: NDArray[np.bool_], image: NDArray[np.uint8], y: int, x: int) -> float:
    """Fit the plane of one pixel by the normal equations of its offsets from their mean."""
    places, weights = [], []
    for i in range(label.shape[0]):
        for j in range(label.shape[1]):
            dx, dy = j - x, i - y
            aligned = dx % completion.PLANE_SPACING_PX == 0 and dy % completion.PLANE_SPACING_PX == 0
            far = max(abs(dx), abs(dy))
            if not aligned or far > completion.PLANE_RADIUS_PX:
                continue
            if (
                abs(label[i, j] - label[y, x])
                > completion.PLANE_TOLERANCE_PX * (1 + 2 * far / completion.PLANE_RADIUS_PX) / 3
            ):
                continue
            difference = np.abs(image[i, j].astype(int) - image[y, x]).sum()
            places.append((dx, dy, label[i, j] - label[y, x]))
            weights.append(
                np.exp(-difference / completion.PLANE_LEVELS)
                * (1.0 if supported[i, j] else completion.CONTINUED_WEIGHT)
            )
    offsets, weight = np.array(places, float), np.array(weights)
    mean = weight @ offsets / weight.sum()
    about = offsets - mean
    moments = about.T @ (weight[:, None] * about)
    stiff = moments[:2, :2] + completion.STIFFNESS_PX2 * weight.sum() * np.eye(2)
    slopes = np.linalg.solve(stiff, moments[:2, 2])
    change = mean[2] - slopes @ mean[:2]
    return float(label[y, x] + np.clip(change, -completion.MAX_CHANGE_PX, completion.MAX_CHANGE_PX))


def test_planes_are_those_of_the_plain_twin() -> None:
    """At borders and corners, with colours and pixels that nothing supports."""
    rng = np.random.default_rng(2)
    label = rng.integers(0, 4, (19, 21)).astype(np.float64)
    supported = rng.random(label.shape) < 0.7
    image = rng.integers(0, 60, (*label.shape, 3)).astype(np.uint8)
    found = fitted_planes(label, supported, image, 1.0)
    for y, x in np.ndindex(label.shape):
        assert found[y, x] == pytest.approx(plain(label, supported, image, y, x), abs=1e-9)


def test_steps_of_a_slanted_surface_become_its_slope() -> None:
    """Whole labels of a plane are a quarter off in the mean, and far less once planes are fitted."""
    y, x = np.mgrid[:40, :60]
    true = 5.0 + 0.21 * x + 0.13 * y
    image = np.full((40, 60, 3), 90, np.uint8)
    label = np.rint(true)
    found = fitted_planes(label, np.ones(label.shape, bool), image, 1.0)
    assert np.abs(label - true).mean() > 0.2
    assert np.abs(found - true)[14:-14, 14:-14].mean() < 0.1


def test_an_edge_stays() -> None:
    """Neighbours of another depth do not count, and no pixel moves farther than it may."""
    label = np.where(np.arange(30) < 15, 3.0, 9.0)[None].repeat(20, axis=0)
    image = np.full((20, 30, 3), 90, np.uint8)
    found = fitted_planes(label, np.ones(label.shape, bool), image, 1.0)
    np.testing.assert_allclose(found, label, atol=1e-9)
    rough = label + np.random.default_rng(1).uniform(-3, 3, label.shape)
    assert np.abs(fitted_planes(rough, label < 5, image, 1.0) - rough).max() == pytest.approx(
        completion.MAX_CHANGE_PX
    )
