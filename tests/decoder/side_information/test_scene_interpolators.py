"""Frames predicted from a scene of two planes, and from key frames that show nothing of use."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import decoder.side_information.mesh
from decoder.side_information import scene_interpolators
from decoder.side_information.mesh import (
    MeshInterpolator,
    barycentric,
    epipolar_lines,
    fit_mesh,
    roughness_matrix,
)
from decoder.side_information.protocol import Interpolation
from decoder.side_information.scene_interpolators import (
    AveragedDepthInterpolator,
    BlockInterpolator,
    DepthInterpolator,
    fuse_scenes,
    relative_parallax,
    spread_blocks,
)
from dvc.geometry.cameras import PixelFrame
from dvc.geometry.plane_sweep import CENSUS_SWEEP
from dvc.geometry.warping import warp_matrix
from dvc.metrics import psnr_db
from dvc.wynerziv.transform import to_uint8
from sfm.scene_model import Correspondences, Model
from tests.scenes_3d import camera_at, render, two_planes

MODEL = two_planes()
FRAME = MODEL.pixel_frame
FIRST, SECOND = (render(position, FRAME)[0] for position in (0.0, 1.0))
SHAPE = FIRST.shape
FINE_CELL_PX = 8
Make = Callable[[Model, np.ndarray, np.ndarray], DepthInterpolator | MeshInterpolator | BlockInterpolator]
METHODS: dict[str, Make] = {
    "depth": DepthInterpolator,
    "mesh": lambda *keys: MeshInterpolator(*keys, cell_px=FINE_CELL_PX),
    "blocks": BlockInterpolator,
}
MIN_PSNR_DB = {"depth": 33.0, "mesh": 24.0, "blocks": 32.0}


def check_complete(prediction: Interpolation, shape: tuple[int, int]) -> None:
    """Assert that there is no hole and nothing that is not a number."""
    assert prediction.luma.shape == shape
    parts = (prediction.luma, *prediction.compensated, *prediction.positions, prediction.expected_error)
    assert all(np.isfinite(part).all() for part in parts)
    assert prediction.luma.min() >= 0
    assert prediction.luma.max() <= 255
    assert prediction.expected_error.min() > 0
    np.testing.assert_allclose(prediction.weights[0] + prediction.weights[1], 1.0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("position", [0.2, 0.5])
def test_the_frame_between_is_predicted(method: str, position: float) -> None:
    prediction = METHODS[method](MODEL, FIRST, SECOND).interpolate(camera_at(position), position)
    check_complete(prediction, SHAPE)
    assert psnr_db(to_uint8(prediction.luma), render(position, FRAME)[0]) > MIN_PSNR_DB[method]


def test_expected_error_is_larger_where_the_error_is() -> None:
    prediction = METHODS["depth"](MODEL, FIRST, SECOND).interpolate(camera_at(0.5), 0.5)
    error = np.abs(prediction.luma - render(0.5, FRAME)[0])
    doubtful = prediction.expected_error > np.quantile(prediction.expected_error, 0.9)
    assert error[doubtful].mean() > 2 * error[~doubtful].mean()


ODD = {
    "black": np.zeros((16, 16), np.uint8),
    "white": np.full((48, 20), 255, np.uint8),
    "noise": np.random.default_rng(0).integers(0, 256, (33, 47)).astype(np.uint8),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("image", ODD)
def test_odd_frames_are_predicted_all_the_same(method: str, image: str) -> None:
    first = ODD[image]
    frame = PixelFrame(first.shape[1], first.shape[0])
    points = np.random.default_rng(1).uniform(0, 15, (12, 2))
    matches = Correspondences(points, points[::-1].copy(), np.zeros(12))
    second = np.random.default_rng(2).permutation(first.ravel()).reshape(first.shape)
    model = Model(frame, np.eye(3), camera_at(1.0), matches, np.linspace(1.0, 9.0, 12))
    prediction = METHODS[method](model, first, second).interpolate(camera_at(0.5), 0.5)
    check_complete(prediction, first.shape)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("points", [0, 1, 3])
def test_models_that_say_little(method: str, points: int) -> None:
    chosen = np.arange(points)
    depths = np.array([2.0, np.inf, -1.0])[:points]
    model = replace(MODEL, correspondences=MODEL.correspondences[chosen], depths=depths)
    if points == 3:
        model = replace(model, second_camera=np.eye(3, 4))
    prediction = METHODS[method](model, FIRST, SECOND).interpolate(model.second_camera, 1.0)
    check_complete(prediction, SHAPE)


def test_forward_motion_with_the_epipole_in_the_picture() -> None:
    forward = np.column_stack([np.eye(3), [0.0, 0.0, -0.5]])
    model = replace(MODEL, second_camera=forward)
    for make in METHODS.values():
        check_complete(make(model, FIRST, FIRST).interpolate(forward, 0.5), SHAPE)


@pytest.mark.parametrize("method", ["depth", "blocks"])
def test_the_same_every_time_and_for_any_number_of_threads(method: str) -> None:
    import cv2

    threads, results = cv2.getNumThreads(), []
    try:
        for number in (1, 4):
            cv2.setNumThreads(number)
            results.append(METHODS[method](MODEL, FIRST, SECOND).interpolate(camera_at(0.3), 0.3).luma)
    finally:
        cv2.setNumThreads(threads)
    np.testing.assert_array_equal(*results)


def test_spread_blocks() -> None:
    depth = np.array([[0.0, 0.02, 0.04, 1.0, 1.02]])
    spread = spread_blocks(depth, 4, (4, 20))
    np.testing.assert_allclose(spread[0, 2:10], np.linspace(0.0025, 0.0375, 8), atol=1e-12)
    assert (np.abs(spread - np.repeat(depth, 4, axis=1)) < 0.02).all()


def test_mesh_reproduces_a_translation() -> None:
    frame = PixelFrame(64, 48)
    sideways = np.column_stack([np.eye(3), [0.1, 0.0, 0.0]])
    points = np.random.default_rng(0).uniform(4, 40, (60, 2))
    matches = Correspondences(points, points + np.array([3.2, 0.0]), np.zeros(60))
    image = np.zeros((48, 64), np.uint8)
    model = Model(frame, np.eye(3), sideways, matches, np.full(60, 2.0))
    mesh = fit_mesh(model, image, image)
    rows, columns = np.indices(mesh.second.shape[:2])
    grid = np.stack([columns, rows], -1) * 16.0 - 16.0
    np.testing.assert_allclose(mesh.second - grid, np.broadcast_to([3.2, 0.0], grid.shape), atol=1e-3)
    np.testing.assert_allclose(mesh.inverse_depth, 0.5, atol=1e-3)
    assert mesh.kept.all()


def test_mesh_drops_outliers(monkeypatch: pytest.MonkeyPatch) -> None:
    second = MODEL.correspondences.second.copy()
    wrong = np.arange(0, len(second), 40)
    second[wrong, 0] += 45.0
    model = replace(MODEL, correspondences=replace(MODEL.correspondences, second=second))
    right = np.setdiff1d(np.arange(len(second)), wrong)
    errors = []
    for max_fits in (1, 8):
        monkeypatch.setattr(decoder.side_information.mesh, "MAX_FITS", max_fits)
        mesh = fit_mesh(model, FIRST, SECOND, FINE_CELL_PX)
        where = barycentric(MODEL.correspondences.first[right], mesh.second.shape[:2], 8.0)
        moved = where.interpolate(mesh.second.reshape(-1, 2))
        errors.append(np.median(np.abs(moved - second[right])))
    assert errors[1] < 0.8 * errors[0]
    assert (~mesh.kept[wrong]).mean() >= 0.5
    assert mesh.kept[right].mean() > 0.5


def test_mesh_equations() -> None:
    points = np.random.default_rng(0).uniform(-8, 24, (30, 2))
    where = barycentric(points, (6, 6), 8.0)
    rows, columns = np.indices((6, 6))
    grid = np.stack([columns.ravel(), rows.ravel()], -1) * 8.0 - 8.0
    np.testing.assert_allclose(where.matrix(36) @ grid, points, atol=1e-12)
    np.testing.assert_allclose(where.interpolate(grid), points, atol=1e-12)
    assert where.weights.min() >= -1e-12
    assert np.abs(roughness_matrix((6, 6)) @ (grid @ [0.3, -0.2] + 1.0)).max() < 1e-12
    warp = warp_matrix(MODEL.first_camera, MODEL.second_camera, FRAME)
    place, direction = epipolar_lines(warp, grid)
    at_infinity = np.column_stack([grid, np.ones(36)]) @ warp[:, :3].T
    lines = np.cross(warp[:, 3], at_infinity)
    for step in (0.0, 7.0):
        on_line = np.column_stack([place + step * direction, np.ones(36)])
        np.testing.assert_allclose((on_line * lines).sum(1) / np.linalg.norm(lines, axis=1), 0.0, atol=1e-9)


MIDDLE = render(0.5, FRAME)[0]


def test_it_is_not_worse_than_the_mean_of_both(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_interpolators, "MIN_PARALLAX", relative_parallax(MODEL))
    luma = AveragedDepthInterpolator(MODEL, FIRST, SECOND).interpolate(camera_at(0.5), 0.5).luma
    single = [
        DepthInterpolator(MODEL, FIRST, SECOND).interpolate(camera_at(0.5), 0.5).luma,
        DepthInterpolator(MODEL, FIRST, SECOND, (None, None), CENSUS_SWEEP)
        .interpolate(camera_at(0.5), 0.5)
        .luma,
    ]
    np.testing.assert_array_equal(luma, 0.5 * (single[0] + single[1]))
    assert min(psnr_db(MIDDLE, to_uint8(one)) for one in single) > 30.0
    errors = [float(np.mean((one - MIDDLE) ** 2)) for one in (luma, *single)]
    assert errors[0] <= 0.5 * (errors[1] + errors[2])


def test_one_depth_is_enough_where_parallax_is_small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_interpolators, "MIN_PARALLAX", 1.001 * relative_parallax(MODEL))
    found = AveragedDepthInterpolator(MODEL, FIRST, SECOND).interpolate(camera_at(0.5), 0.5)
    expected = DepthInterpolator(MODEL, FIRST, SECOND).interpolate(camera_at(0.5), 0.5)
    np.testing.assert_array_equal(found.luma, expected.luma)


def rendered(level: float, error: float) -> Interpolation:
    """Return an even prediction that expects some error."""
    plane: NDArray[np.float64] = np.full((20, 30), level)
    positions = np.zeros((20, 30, 2))
    return Interpolation(
        plane, (plane, plane), (plane, plane), (positions, positions), np.full_like(plane, error)
    )


def test_the_one_that_expects_less_error_counts_more() -> None:
    for errors, near in (((1.0, 20.0), 100.0), ((20.0, 1.0), 110.0)):
        fused = fuse_scenes(rendered(100.0, errors[0]), rendered(110.0, errors[1]))
        assert (np.abs(fused.luma - near) < 0.5).all()
        np.testing.assert_allclose(fused.compensated[0], fused.luma)
        assert [plane.mean() for plane in fused.hypotheses] == [100.0, 110.0]


def test_shares_are_inverse_squared_errors() -> None:
    """At the same error blocks count half as much as depth, at twice the error an eighth."""
    for errors, share in (((2.0, 2.0), 1 / 3), ((2.0, 4.0), 1 / 9), ((4.0, 2.0), 2 / 3)):
        fused = fuse_scenes(rendered(100.0, errors[0]), rendered(110.0, errors[1]))
        np.testing.assert_allclose(fused.luma, 100.0 + 10.0 * share)


def test_disagreement_is_uncertainty() -> None:
    errors = [fuse_scenes(rendered(100.0, 2.0), rendered(100.0 + d, 2.0)).expected_error for d in (0, 10, 30)]
    np.testing.assert_allclose(errors[0], 2.0)
    assert (errors[0] < errors[1]).all()
    assert (errors[1] < errors[2]).all()
