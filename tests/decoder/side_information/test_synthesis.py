"""Residuals of tracks as local corrections of what is rendered."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from decoder.side_information.protocol import Interpolation
from decoder.side_information.synthesis import block_offsets
from decoder.side_information.track_interpolation import (
    NEAR,
    PRIOR,
    add_correction,
    corrected,
    correction_field,
    track_residuals,
)
from dvc._jit import python_twin
from dvc.geometry.warping import sample
from tests.clips import moving_texture

Floats = NDArray[np.float64]
SHAPE = (40, 56)
FIELD = NEAR[0]


def points_and_residuals(seed: int, number: int) -> tuple[Floats, Floats]:
    """Return scattered points whose residuals agree but for some noise."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0.0, 39.0, (number, 2))
    return points, np.array([2.0, -1.0]) + rng.normal(0.0, 0.3, (number, 2))


def plain_field(points: Floats, residuals: Floats, reach: float) -> Floats:
    """Compute the field with arrays over points."""
    field = np.zeros((*SHAPE, 2))
    for y, x in np.ndindex(*SHAPE):
        squared = ((points - np.array([x, y])) ** 2).sum(axis=1)
        weights = np.maximum(1.0 - squared / reach**2, 0.0) ** 3
        if weights.sum() == 0.0:
            continue
        mean = np.average(residuals, axis=0, weights=weights)
        spread = float(np.average(((residuals - mean) ** 2).sum(axis=1), weights=weights))
        chance = (spread + FIELD.noise_px2) * (weights**2).sum() / weights.sum() ** 2
        share = max(0.0, 1.0 - chance / float(mean @ mean))
        field[y, x] = mean * share * weights.sum() / (weights.sum() + PRIOR)
    return field


@pytest.mark.nojit
@pytest.mark.parametrize("reach", [15.0, FIELD.reach_px])
@pytest.mark.parametrize("compiled", [True, False])
def test_the_kernel_is_its_twin(compiled: bool, reach: float) -> None:
    points, residuals = points_and_residuals(1, 12)
    field = np.empty((*SHAPE, 2))
    run = correction_field if compiled else python_twin(correction_field)
    run(points, residuals, reach, PRIOR, FIELD.noise_px2, field)
    np.testing.assert_allclose(field, plain_field(points, residuals, reach), atol=1e-9)
    assert (field[:, -1] == 0.0).any() == (reach == 15.0)


def test_what_neighbours_agree_on_is_corrected() -> None:
    points, residuals = points_and_residuals(2, 40)
    nowhere = np.zeros((*SHAPE, 2))
    agreed = add_correction(nowhere, points, residuals, FIELD)[20, 20]
    np.testing.assert_allclose(agreed, [2.0, -1.0], atol=0.3)
    signs = np.where(np.arange(40) % 2, 1.0, -1.0)[:, None]
    assert np.abs(add_correction(nowhere, points, residuals * signs, FIELD)).max() < 0.5
    for few in (0, 2):
        assert not add_correction(nowhere, points[:few], residuals[:few], FIELD).any()


def test_a_correction_is_bilinear_between_nodes() -> None:
    points, residuals = points_and_residuals(4, 12)
    start = np.random.default_rng(4).normal(size=(*SHAPE, 2))
    field = add_correction(start, points, residuals, FIELD) - start
    at = np.mgrid[:37, :53] / 4
    bilinear = [map_coordinates(field[::4, ::4, axis], at, order=1) for axis in (0, 1)]
    np.testing.assert_allclose(field[:37, :53], np.stack(bilinear, axis=-1), atol=1e-12)
    assert np.abs(field).max() > 0.5


def test_block_offsets() -> None:
    motion = np.random.default_rng(3).uniform(-9.0, 9.0, (10, 14, 2))
    positions = np.stack(np.mgrid[:10, :14][::-1], axis=-1) + motion
    plane = np.zeros((10, 14))
    (offsets,) = block_offsets(Interpolation(plane, (plane,), (plane,), (positions,), plane))
    cells = np.pad(motion[..., ::-1], ((0, 2), (0, 2), (0, 0)), mode="edge").reshape(3, 4, 4, 4, 2)
    np.testing.assert_array_equal(offsets, np.floor(4.0 * np.median(cells, axis=(1, 3)) + 0.5))


def test_only_points_that_tell_something_count() -> None:
    rows, columns = np.indices(SHAPE).astype(np.float64)
    positions = np.stack([columns + 1.0, rows], axis=-1)
    wanted = np.array([[10.5, 7.25], [np.nan, 3.0], [-0.1, 3.0], [55.5, 3.0], [20.0, 20.0], [5.0, 5.0]])
    reference = wanted + np.array([1.5, 0.5])
    reference[4] += 10.0
    reference[5] = np.nan
    points, residuals = track_residuals(wanted, reference, positions, FIELD.max_residual_px)
    np.testing.assert_array_equal(points, [[10.5, 7.25]])
    np.testing.assert_allclose(residuals, [[0.5, 0.5]])


def test_a_camera_that_is_off_is_made_up_for() -> None:
    keys = moving_texture(1, *SHAPE)[0].luma, moving_texture(1, *SHAPE)[0].luma
    rows, columns = np.indices(SHAPE).astype(np.float64)
    true = np.stack([columns, rows], axis=-1)
    off = true + np.array([2.0, -1.0])
    half = np.full(SHAPE, 0.5)
    wrong = sample(keys[0], off)
    rendered = Interpolation(wrong, (wrong, wrong), (half, half), (off, off), half)
    points = np.random.default_rng(3).uniform(0.0, 39.0, (60, 2))
    found = corrected(rendered, keys, (points, points, points))
    errors = [np.abs(luma - keys[0])[4:-4, 4:-20].mean() for luma in (wrong, found.luma)]
    assert errors[1] < 0.2 * errors[0]
    np.testing.assert_allclose(found.compensated[0], found.luma)
    nothing = corrected(rendered, keys, (points[:0],) * 3)
    np.testing.assert_array_equal(nothing.luma, wrong)
