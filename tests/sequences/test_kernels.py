"""Compiled kernels of the renderer against plain twins, compiled and as Python."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from dvc._jit import python_twin
from sequences import _kernels
from sequences._kernels import NEAR_M
from sequences.patterns import SIZE
from sequences.textures import build

Floats = NDArray[np.float64]
BOTH = pytest.mark.parametrize("form", [lambda k: k, python_twin], ids=["compiled", "python"])
Form = Callable[[Any], Any]
NOJIT = pytest.mark.nojit


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
@BOTH
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_rasterizer_finds_what_ray_casting_finds(form: Form, seed: int) -> None:
    """Every sample keeps the nearest triangle that its ray meets."""
    points, triangles = random_triangles(seed)
    inverse, ids = np.zeros((10, 14), dtype=np.float32), np.full((10, 14), -1, dtype=np.int32)
    form(_kernels.rasterize)(points, triangles, inverse, ids)
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
@BOTH
def test_point_casting_finds_what_ray_casting_finds(form: Form) -> None:
    """Points between pixel centres get the depth of the nearest triangle."""
    points, triangles = random_triangles(5)
    rng = np.random.default_rng(6)
    xy = rng.uniform((-0.5, -0.5), (13.49, 9.49), (60, 2))
    cell = np.floor(xy + 0.5).astype(int) @ [1, 14]
    order = np.argsort(cell, kind="stable")
    ends = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=140))])
    start = ends[np.arange(10)[:, None] * 14 + np.arange(15)]
    depth, ids = np.full(60, np.inf), np.full(60, -1, dtype=np.int32)
    form(_kernels.cast_points)(points, triangles, xy, start, order, depth, ids)
    for k in range(60):
        depths = [hit(points[t], *xy[k]) for t in triangles]
        assert depth[k] == pytest.approx(min(depths), rel=1e-9)


@NOJIT
def test_neighbouring_triangles_leave_no_gap() -> None:
    """A fan of triangles that share edges covers every sample inside it."""
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
def test_narrowed_range_keeps_all_that_is_inside(slope: float, offset: float, low: int, length: int) -> None:
    """No column with ``slope * column + offset >= 0`` is lost."""
    first, last = _kernels.narrow(slope, offset, low, low + length)
    assert (first, last) == python_twin(_kernels.narrow)(slope, offset, low, low + length)
    for column in range(low, low + length + 1):
        if slope * column + offset >= 0.0:
            assert first <= column <= last


@NOJIT
@BOTH
def test_transform_is_a_matrix_product(form: Form) -> None:
    """Points go through the matrix, translation included."""
    rng = np.random.default_rng(4)
    matrix, points, out = rng.normal(size=(3, 4)), rng.normal(size=(9, 3)), np.empty((9, 3))
    form(_kernels.transform)(matrix, points, out)
    np.testing.assert_allclose(out, points @ matrix[:, :3].T + matrix[:, 3], rtol=1e-12)


@NOJIT
@BOTH
def test_bilinear_lookup_wraps_round(form: Form) -> None:
    """The texture is interpolated between linear values of its four texels, across the seam as well."""
    textures = build(["paint"], 0)
    number, level = 10, 3
    side = SIZE >> level
    start = textures.offsets[number, level]
    image = (textures.texels[start : start + 3 * side * side].reshape(side, side, 3) / 255.0) ** 2
    out = np.empty(3)
    for u, v in ((0.31, 0.77), (0.999, 0.002), (-1.25, 3.5)):
        form(_kernels.bilinear)(textures, number, level, u, v, out)
        x, y = u * side - 0.5, v * side - 0.5
        j, i = int(np.floor(x)), int(np.floor(y))
        expected = sum(
            (1 - abs(y - i - di)) * (1 - abs(x - j - dj)) * image[(i + di) % side, (j + dj) % side]
            for di in (0, 1)
            for dj in (0, 1)
        )
        np.testing.assert_allclose(out, expected, rtol=1e-9)


@NOJIT
@BOTH
def test_wide_footprints_see_the_mean_of_a_texture(form: Form) -> None:
    """A footprint of a whole tile gives the coarsest level; a point gives the finest."""
    textures = build(["paint"], 0)
    out, work, exact = np.empty(3), np.empty(3), np.empty(3)
    form(_kernels.filtered)(textures, 10, 0.3, 0.4, np.array([1.0, 0.0, 0.0, 1.0]), out, work)
    mean = (textures.texels[textures.offsets[10, -1]] / 255.0) ** 2
    assert out[0] == pytest.approx(mean, abs=0.01)
    form(_kernels.filtered)(textures, 10, 0.3, 0.4, np.zeros(4), out, work)
    _kernels.bilinear(textures, 10, 0, 0.3, 0.4, exact)
    np.testing.assert_allclose(out, exact, rtol=1e-12)
    form(_kernels.filtered)(textures, 10, 0.3, 0.4, np.array([0.05, 0.0, 0.0, 0.003]), out, work)
    assert abs(out[0] - mean) < 0.1


@NOJIT
@BOTH
def test_resolve_is_a_separable_average(form: Form) -> None:
    """Each pixel is the weighted mean of its window of samples."""
    rng = np.random.default_rng(8)
    samples, taps = rng.random((11, 14, 3)).astype(np.float32), np.array([1, 2, 3, 2, 1]) / 9
    out = np.empty((3, 4, 3), dtype=np.float32)
    form(_kernels.resolve)(samples, taps, 3, out)
    for i in range(3):
        for j in range(4):
            window = samples[3 * i : 3 * i + 5, 3 * j : 3 * j + 5]
            np.testing.assert_allclose(out[i, j], np.einsum("i,j,ijk", taps, taps, window), rtol=1e-5)


@NOJIT
@BOTH
def test_visibility_counts_what_no_surface_hides(form: Form) -> None:
    """Light reaches a vertex before the surface or outside the map, not behind it; weight 0 is skipped."""
    projected = np.array([[2.0, 2.0, 1.0], [2.0, 2.0, 1.0], [90.0, 2.0, 1.0], [2.0, 2.0, 1.0]])
    projected[1] *= 3.0
    inverse = np.full((5, 5), 0.5, dtype=np.float32)
    seen, total = np.zeros(4), np.zeros(4)
    form(_kernels.add_visibility)(projected, inverse, np.array([1.0, 0.7, 0.4, 0.0]), 0.1, seen, total)
    np.testing.assert_allclose(seen, [1.0, 0.0, 0.4, 0.0])
    np.testing.assert_allclose(total, [1.0, 0.7, 0.4, 0.0])


@BOTH
def test_picture_is_shaded_alike_in_both_forms(form: Form) -> None:
    """A small view of a scene has the same colours from the compiled kernel and from Python."""
    from sequences.scenes import scene

    stairway = scene("stairway", 0, 0.05)
    camera = stairway.camera(0, 12, 9)
    projected = np.empty_like(stairway.surface.points)
    _kernels.transform(camera.projection, stairway.surface.points, projected)
    inverse, ids = np.zeros((9, 12), dtype=np.float32), np.full((9, 12), -1, dtype=np.int32)
    _kernels.rasterize(projected, stairway.surface.triangles, inverse, ids)
    rays = camera.cam_from_world[:, :3].T @ np.linalg.inv(camera.K)
    parts = (stairway.surface, stairway.textures, stairway.light, projected, rays, ids, inverse)
    expected, colour = np.empty((2, 9, 12, 3), dtype=np.float32)
    _kernels.shade(*parts, expected)
    form(_kernels.shade)(*parts, colour)
    np.testing.assert_allclose(colour, expected, rtol=1e-5)
    assert (colour >= 0).all()
    assert (ids >= 0).any()
