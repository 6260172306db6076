"""Compiled kernels of the renderer against plain twins, compiled and as Python."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from dvc._jit import python_twin
from dvc.arrays import Floats
from sequences import _kernels
from sequences._kernels import NEAR_M
from sequences.rendered_scenes import scene
from sequences.scene_cameras import transformed
from sequences.shapes import MATERIALS, Material
from tests.twins import Choose

NOJIT = pytest.mark.nojit


def materials_of(*materials: Material) -> _kernels.Materials:
    columns = [np.array(column, dtype=np.float64) for column in zip(*materials, strict=True)]
    return _kernels.Materials._make([*columns, 0])


def random_triangles(seed: int, count: int = 40) -> tuple[Floats, NDArray[np.int32]]:
    """Draw homogeneous triangles around a 14x10 image: before, behind, across the near plane, flat."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.5, 9.0, (count, 3, 1))
    depth[:6] = rng.uniform(-2.0, 2.0, (6, 3, 1))
    depth[6:8] = -1.0
    xy = rng.uniform(-8, 22, (count, 1, 2)) + rng.uniform(-7, 7, (count, 3, 2))
    corners = np.concatenate([xy * depth, depth], axis=2)
    corners[8, 2] = corners[8, 1]
    return corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def hit(corners: Floats, x: float, y: float) -> float:
    """Return the depth at which a ray through (x, y) meets a triangle, inf if it does not: Cramer's rule."""
    ray = np.array([x, y, 1.0])
    det = np.linalg.det(corners.T)
    if abs(det) < 1e-12:
        return np.inf
    b = np.linalg.solve(corners.T, ray)
    if (b < -1e-12).any() or b.sum() <= 0 or 1.0 / b.sum() <= NEAR_M:
        return np.inf
    return float(1.0 / b.sum())


@NOJIT
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_rasterizer_agrees_with_ray_casting(choose: Choose, seed: int) -> None:
    points, triangles = random_triangles(seed)
    inverse, ids = np.zeros((10, 14), dtype=np.float32), np.full((10, 14), -1, dtype=np.int32)
    choose(_kernels.rasterize)(points, triangles, inverse, ids)
    for row in range(10):
        for column in range(14):
            depths = [hit(points[t], column, row) for t in triangles]
            nearest = min(depths)
            if np.isinf(nearest):
                assert ids[row, column] == -1
            else:
                assert 1.0 / inverse[row, column] == pytest.approx(nearest, rel=1e-5)
                assert depths[ids[row, column]] == pytest.approx(nearest, rel=1e-5)


@NOJIT
def test_point_casting_agrees_with_ray_casting(choose: Choose) -> None:
    points, triangles = random_triangles(5)
    rng = np.random.default_rng(6)
    xy = rng.uniform((-0.5, -0.5), (13.49, 9.49), (60, 2))
    cell = np.floor(xy + 0.5).astype(int) @ [1, 14]
    order = np.argsort(cell, kind="stable")
    ends = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=140))])
    start = ends[np.arange(10)[:, None] * 14 + np.arange(15)]
    depth, ids = np.full(60, np.inf), np.full(60, -1, dtype=np.int32)
    choose(_kernels.cast_points)(points, triangles, xy, start, order, depth, ids)
    for k in range(60):
        depths = [hit(points[t], *xy[k]) for t in triangles]
        assert depth[k] == pytest.approx(min(depths), rel=1e-9)


@NOJIT
def test_neighbouring_triangles_leave_no_gap() -> None:
    rng = np.random.default_rng(3)
    angle = np.linspace(0, 2 * np.pi, 31)[:-1]
    rim = np.stack([20.3 + 15 * np.cos(angle), 20.1 + 15 * np.sin(angle), np.ones(30)], axis=1)
    points = np.concatenate([[[20.0, 20.0, 1.0]], rim]) * rng.uniform(1, 4, (31, 1))
    k = np.arange(30)
    triangles = np.stack([np.zeros(30), 1 + k, 1 + (k + 1) % 30], axis=1).astype(np.int32)
    inverse, ids = np.zeros((41, 41), dtype=np.float32), np.full((41, 41), -1, dtype=np.int32)
    _kernels.rasterize(points, triangles, inverse, ids)
    y, x = np.mgrid[:41, :41]
    assert (ids[np.hypot(x - 20.3, y - 20.1) < 14.8] >= 0).all()


@NOJIT
@given(st.floats(-9, 9), st.floats(-200, 200), st.integers(0, 20), st.integers(0, 40))
def test_narrowed_range_keeps_all_columns_inside(slope: float, offset: float, low: int, length: int) -> None:
    first, last = _kernels.narrow(slope, offset, low, low + length)
    assert (first, last) == python_twin(_kernels.narrow)(slope, offset, low, low + length)
    for column in range(low, low + length + 1):
        if slope * column + offset >= 0.0:
            assert first <= column <= last


@NOJIT
def test_noise_is_smooth_and_fades_out(choose: Choose) -> None:
    """Noise has mean 0, deviation near 1 and no jumps, and vanishes in a large footprint."""
    noise = choose(_kernels.noise)
    at = np.random.default_rng(7).uniform(-40.0, 40.0, (600, 2))
    values = np.array([noise(x, y, 0.0, 0.8, 3) for x, y in at])
    assert abs(values.mean()) < 0.15
    assert 0.7 < values.std() < 1.3
    near = np.array([noise(x + 1e-7, y, 0.0, 0.8, 3) for x, y in at])
    assert np.abs(near - values).max() < 1e-3
    assert noise(2.0 - 1e-9, 0.3, 0.4, 0.8, 3) == pytest.approx(noise(2.0 + 1e-9, 0.3, 0.4, 0.8, 3), abs=1e-6)
    assert max(abs(noise(x, y, 0.51, 0.8, 3)) for x, y in at[:50]) == 0.0
    assert noise(0.3, 0.4, 0.0, 0.8, 3) != noise(0.3, 0.4, 0.0, 0.8, 4)


@NOJIT
def test_courses_have_joints_and_no_period(choose: Choose) -> None:
    """Joints have their share of a wall and their colour; stones differ; from afar a wall has its mean."""
    materials = materials_of(Material((0.5, 0.25), (0.05, 0.02), (0.9, 0.1, 0.1), spread=(0.3, 0.0)))
    rgb, tint = np.empty(3), np.array([0.2, 0.5, 0.2])

    def colour(u: float, v: float, size: float) -> Floats:
        choose(_kernels.texture)(materials, 0, np.array([u, v, size]), tint, rgb)
        return rgb.copy()

    v, u = np.mgrid[0.0125:2.0:0.025, 0.0125:4.0:0.025]
    seen = np.array([colour(x, y, 0.002) for x, y in zip(u.ravel(), v.ravel(), strict=True)])
    joints = seen[:, 0] > 0.5
    assert joints.mean() == pytest.approx(1.0 - 0.9 * 0.8, abs=0.05)
    stones = np.unique(seen[~joints][:, 1].round(6))
    assert len(stones) > 30
    afar = colour(0.3, 0.4, 3.0)
    np.testing.assert_allclose(afar, seen.mean(axis=0), atol=0.06)


@NOJIT
def test_materials_look_alike_in_both_forms() -> None:
    materials = materials_of(*MATERIALS.values())
    compiled, plain = np.empty(3), np.empty(3)
    for k, place in itertools.product(range(len(MATERIALS)), [(0.3, -1.7, 0.004), (12.1, 3.3, 0.05)]):
        _kernels.texture(materials, k, np.array(place), np.full(3, 0.4), compiled)
        python_twin(_kernels.texture)(materials, k, np.array(place), np.full(3, 0.4), plain)
        np.testing.assert_allclose(compiled, plain, rtol=1e-9)
        assert 0.0 <= compiled.min() <= compiled.max() < 1.5


def test_picture_is_shaded_alike_in_both_forms(choose: Choose) -> None:
    stairway = scene("stairway")
    camera = stairway.camera(0, 12, 9)
    projected = transformed(camera.projection, stairway.surface.points)
    inverse, ids = np.zeros((9, 12), dtype=np.float32), np.full((9, 12), -1, dtype=np.int32)
    _kernels.rasterize(projected, stairway.surface.triangles, inverse, ids)
    ids[0, :3] = -1  # sky
    rays = camera.cam_from_world[:, :3].T @ np.linalg.inv(camera.K)
    parts = (stairway.surface, stairway.materials, stairway.light, projected, rays, ids, inverse)
    expected, colour = np.empty((2, 9, 12, 3), dtype=np.float32)
    _kernels.shade(*parts, expected)
    choose(_kernels.shade)(*parts, colour)
    np.testing.assert_allclose(colour, expected, rtol=1e-5)
    assert (colour >= 0).all()
    assert (ids >= 0).any()
