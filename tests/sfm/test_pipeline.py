"""From two pictures to a model, and verdicts on pictures that show no scene."""

from dataclasses import replace

import numpy as np
import pytest

from dvc.config import SFM_BACKENDS
from dvc.geometry.cameras import PixelFrame, project
from sfm import pipeline
from sfm.estimation.epipolar import (
    fundamental_from_camera,
    fundamental_to_pixels,
    symmetric_distances,
    unit_norm,
)
from sfm.pipeline import coverage, points_needed, reconstruct
from sfm.scene_model import Correspondences, Reconstruction
from tests.clips import moving_texture
from tests.scenes_3d import camera_at, render
from tests.sfm.textures import picture, texture

FRAME = PixelFrame(176, 144)
FIRST, SECOND = (render(position, FRAME)[0] for position in (0.0, 1.0))
TRUTH = unit_norm(fundamental_to_pixels(fundamental_from_camera(camera_at(1.0)), FRAME))
TEXTURE = texture(2)
ZOOM = np.array([[0.93, 0.0, 6.0], [0.0, 0.93, 5.0], [0.0, 0.0, 1.0]])
TURN = np.array([[0.99, -0.1, 9.0], [0.1, 0.99, -8.0], [3e-4, 1e-4, 1.0]])
NOISE = np.random.default_rng(4).integers(0, 256, (2, 72, 88), dtype=np.uint8)
ODD_PAIRS = {
    "black": (np.zeros((72, 88), np.uint8),) * 2,
    "constant": (np.full((72, 88), 90, np.uint8), np.full((72, 88), 200, np.uint8)),
    "identical": (FIRST, FIRST),
    "noise": (NOISE[0], NOISE[1]),
    "unrelated": (FIRST, moving_texture(1, 144, 176, seed=9)[0].luma),
    "one pixel": (np.zeros((1, 1), np.uint8),) * 2,
    "16x16": (FIRST[:16, :16].copy(), SECOND[:16, :16].copy()),
    "shifted plane": tuple(frame.luma for frame in moving_texture(2, 144, 176, (3.0, 4.0))),
    "pure zoom": (picture(TEXTURE, 144, 176), picture(TEXTURE, 144, 176, ZOOM)),
    "pure rotation": (picture(TEXTURE, 144, 176), picture(TEXTURE, 144, 176, TURN)),
    "fast motion": tuple(frame.luma for frame in moving_texture(2, 72, 88, (60.0, 40.0))),
    "zoom of nothing": (np.tile(np.arange(88, dtype=np.uint8), (72, 1)),) * 2,
}


@pytest.fixture(scope="module", params=SFM_BACKENDS)
def reconstruction(request: pytest.FixtureRequest) -> Reconstruction:
    """Return what each backend makes of the scene of two planes."""
    return reconstruct(FIRST, SECOND, backend=request.param, seed=1)


def test_two_planes_are_reconstructed(reconstruction: Reconstruction) -> None:
    assert reconstruction.success
    assert reconstruction.motion == "general"
    model = reconstruction.model
    assert model is not None
    grid = np.stack(np.meshgrid(np.arange(8, 170, 9.0), np.arange(8, 140, 9.0)), axis=-1).reshape(-1, 2)
    _, inverse_depth = render(0.0, FRAME)
    depth = 1.0 / inverse_depth[grid[:, 1].astype(int), grid[:, 0].astype(int)]
    normalized = FRAME.to_normalized(grid)
    world = np.column_stack([depth[:, None] * normalized, depth, np.ones(len(grid))])
    second = FRAME.to_pixels(project(camera_at(1.0), world)[0])
    assert np.median(symmetric_distances(model.fundamental, grid, second)) < 0.15


def test_stages_grow_and_shrink(reconstruction: Reconstruction) -> None:
    """Calibration drops outliers, propagation adds many; all lie near the true epipolar lines."""
    counts = {name: len(matches) for name, matches in reconstruction.stages.items()}
    assert list(counts) == ["matching", "weak calibration", "bundle adjustment", "propagation"]
    assert counts["matching"] >= counts["weak calibration"] >= counts["bundle adjustment"] >= 50
    assert counts["propagation"] > 10 * counts["bundle adjustment"]
    last = reconstruction.stages["propagation"]
    assert np.percentile(symmetric_distances(TRUTH, last.first, last.second), 95) < 0.5


def test_models_are_consistent(reconstruction: Reconstruction) -> None:
    model = reconstruction.model
    assert model is not None
    assert model.depths.min() > 0
    projected = model.pixel_frame.to_pixels(project(model.second_camera, model.points)[0])
    offset = np.linalg.norm(projected - model.correspondences.second, axis=1)
    assert np.percentile(offset, 99) < 1.0
    implied = fundamental_to_pixels(fundamental_from_camera(model.second_camera), model.pixel_frame)
    np.testing.assert_allclose(np.abs(np.vdot(unit_norm(implied), model.fundamental)), 1.0, atol=1e-9)


@pytest.mark.parametrize("backend", SFM_BACKENDS)
def test_the_seed_decides(backend: str) -> None:
    first, second = (reconstruct(FIRST, SECOND, backend=backend, seed=7).model for _ in range(2))
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first.second_camera, second.second_camera)
    np.testing.assert_array_equal(first.correspondences.second, second.correspondences.second)
    np.testing.assert_array_equal(first.depths, second.depths)


@pytest.mark.parametrize("backend", SFM_BACKENDS)
@pytest.mark.parametrize(("name", "pair"), ODD_PAIRS.items())
def test_odd_pictures_give_a_reason(name: str, pair: tuple[np.ndarray, np.ndarray], backend: str) -> None:
    found = reconstruct(*pair, backend=backend)
    assert not found.success
    assert found.reason
    assert "\n" not in found.reason
    assert found.motion in {"general", "rotation", "none", "unknown"}


def test_tracked_points_count_among_matches() -> None:
    """They are tested as others are: those that obey the epipolar constraint stay, wrong ones go."""
    rng, known = np.random.default_rng(3), reconstruct(FIRST, SECOND, seed=1)
    right = known.stages["bundle adjustment"][np.arange(40)]
    wrong = replace(right, first=rng.uniform(20, 120, (40, 2)), second=rng.uniform(20, 120, (40, 2)))
    tracked = Correspondences.concatenate([right, wrong])
    found = reconstruct(FIRST, SECOND, seed=1, tracked=tracked)
    assert len(found.stages["matching"]) == len(known.stages["matching"]) + 80
    kept = {tuple(point) for point in found.stages["weak calibration"].first}
    assert np.mean([tuple(point) in kept for point in right.first]) > 0.9
    assert np.mean([tuple(point) in kept for point in wrong.first]) < 0.2


@pytest.mark.parametrize("reach_px", [1e3, 1e6, 1e12])
def test_wild_tracked_points_do_no_harm(reach_px: float) -> None:
    first, second = np.random.default_rng(0).uniform(-reach_px, reach_px, (2, 60, 2))
    found = reconstruct(FIRST, SECOND, seed=1, tracked=Correspondences(first, second, np.zeros(60)))
    assert found.success
    assert found.model is not None
    points = found.model.correspondences
    assert (np.concatenate([points.first, points.second]) < [FRAME.width_px, FRAME.height_px]).all()


def test_untrusted_models_have_a_reason_and_wrong_arguments_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sizes = (88, 72), (352, 288), (704, 576)
    assert [points_needed(PixelFrame(*size)) for size in sizes] == [50, 100, 100]
    monkeypatch.setattr(pipeline, "MIN_NUM_POINTS", 10**6)
    found = reconstruct(FIRST, SECOND)
    assert found.model is not None
    assert not found.success
    assert "correspondences" in found.reason
    with pytest.raises(ValueError, match="one size"):
        reconstruct(FIRST, FIRST[:-1])
    with pytest.raises(ValueError, match="backend"):
        reconstruct(FIRST, SECOND, backend="magic")


def test_coverage_counts_cells() -> None:
    """One point fills one cell of 64; points on the border and beyond are counted too."""
    frame = PixelFrame(80, 40)
    assert coverage(np.empty((0, 2)), frame) == 0
    assert coverage(np.array([[1.0, 1.0], [2.0, 2.0]]), frame) == 1 / 64
    assert coverage(np.array([[79.4, 39.4], [-0.5, -0.5], [200.0, -3.0]]), frame) == 3 / 64
