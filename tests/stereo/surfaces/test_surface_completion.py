"""Completion of surfaces: continuation, planes between labels, fusion of cameras, and confidence."""

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.thesis import chapter2 as figure
from dvc.geometry.camera_array import DisparityLabels, LatticePosition
from dvc.stereo.evaluation import sparsification
from dvc.stereo.surfaces import surface_completion as completion
from dvc.stereo.surfaces.occupancy import Occupancy, shifts
from dvc.stereo.surfaces.reconstruct import reconstruct
from dvc.stereo.surfaces.surface_completion import (
    continued,
    evidence,
    fitted_planes,
    fused,
)
from tests.reference import stereo_volumes as volumes
from tests.stereo.data import array_of
from tests.stereo.plane_scenes import BACKGROUND, LABELS, SCENE, reconstruction_of, square_lattice
from tests.twins import Choose

SHAPE = (40, 60)
FINE_LABELS = DisparityLabels(1.0, 0.5, 24)
Pair = tuple[LatticePosition, LatticePosition]
PAIR = LatticePosition(0.0, 0.0), LatticePosition(1.0, 0.0)
BLACK = np.zeros((*SHAPE, 3), np.uint8)
NOWHERE = Occupancy(np.zeros(SHAPE, np.int64), np.zeros(SHAPE, bool))


def filled(own: Occupancy, other: Occupancy, pair: Pair, image: NDArray[np.uint8]) -> NDArray[np.float64]:
    return continued(own, other, FINE_LABELS, pair, image, 1.0)


def test_supported_labels_stay_and_planes_go_on() -> None:
    plane = 4.0 + 0.11 * np.indices(SHAPE)[1] + 0.05 * np.indices(SHAPE)[0]
    label = np.floor(plane + 0.5).astype(np.int64)
    supported = np.ones(SHAPE, bool)
    supported[12:26, 20:36] = False
    found = filled(Occupancy(np.where(supported, label, 0), supported), NOWHERE, PAIR, BLACK)
    np.testing.assert_array_equal(found[supported], label[supported])
    assert np.abs(found - plane)[~supported].max() < 1.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_background_goes_on_beside_an_object(side: float) -> None:
    far, near = 2, 12
    label = np.full(SHAPE, far)
    label[:, 25:40] = near
    width = int((near - far) * FINE_LABELS.step)
    hidden = slice(25 - width, 25) if side > 0 else slice(40, 40 + width)
    supported = np.ones(SHAPE, bool)
    supported[:, hidden] = False
    other = np.full(SHAPE, far)
    start = int(25 - side * FINE_LABELS.disparity(np.array(float(near))))
    other[:, start : start + 15] = near
    pair = LatticePosition(0.0, 0.0), LatticePosition(side, 0.0)
    seen = Occupancy(other, np.ones(SHAPE, bool))
    found = filled(Occupancy(np.where(supported, label, 9), supported), seen, pair, BLACK)
    assert (np.abs(found[:, hidden] - far) < 0.5).mean() > 0.9


def test_surfaces_end_at_edges_of_the_picture() -> None:
    far, near, edge = 3, 10, 33
    label = np.where(np.indices(SHAPE)[1] < 30, far, near)
    supported = np.ones(SHAPE, bool)
    supported[:, 24:40] = False
    image = np.where(np.indices(SHAPE)[1] < edge, 40, 200).astype(np.uint8)
    found = filled(Occupancy(label, supported), NOWHERE, PAIR, np.repeat(image[:, :, None], 3, axis=2))
    expected = np.where(np.indices(SHAPE)[1] < edge, far, near)
    assert (np.abs(found - expected) < 0.5).mean() > 0.97


def test_result_stays_among_the_labels() -> None:
    steep = np.clip(np.indices(SHAPE)[1] // 3, 0, FINE_LABELS.num_labels - 1)
    supported = np.indices(SHAPE)[1] < 40
    for occupancy in (Occupancy(steep, supported), Occupancy(steep, np.zeros(SHAPE, bool))):
        found = filled(occupancy, NOWHERE, PAIR, BLACK)
        assert np.isfinite(found).all()
        assert found.min() >= 0.0
        assert found.max() <= FINE_LABELS.num_labels - 1


def test_planes_that_leave_the_labels_stay_at_the_last() -> None:
    plane = np.floor(20.5 + 0.08 * np.indices(SHAPE)[1]).astype(np.int64)
    found = filled(Occupancy(plane, np.indices(SHAPE)[1] < 36), NOWHERE, PAIR, BLACK)
    assert found.max() == FINE_LABELS.num_labels - 1
    assert (found[:, -4:] == FINE_LABELS.num_labels - 1).all()


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
            limit = completion.PLANE_TOLERANCE_PX * (1 + 2 * far / completion.PLANE_RADIUS_PX) / 3
            if abs(label[i, j] - label[y, x]) > limit:
                continue
            difference = np.abs(image[i, j].astype(int) - image[y, x]).sum()
            places.append((dx, dy, label[i, j] - label[y, x]))
            share = 1.0 if supported[i, j] else completion.CONTINUED_WEIGHT
            weights.append(share * np.exp(-difference / completion.PLANE_LEVELS))
    offsets, weight = np.array(places, float), np.array(weights)
    mean = weight @ offsets / weight.sum()
    about = offsets - mean
    moments = about.T @ (weight[:, None] * about)
    stiff = moments[:2, :2] + completion.STIFFNESS_PX2 * weight.sum() * np.eye(2)
    slopes = np.linalg.solve(stiff, moments[:2, 2])
    change = mean[2] - slopes @ mean[:2]
    return float(label[y, x] + np.clip(change, -completion.MAX_CHANGE_PX, completion.MAX_CHANGE_PX))


def test_planes_are_those_of_the_plain_twin() -> None:
    rng = np.random.default_rng(2)
    label = rng.integers(0, 4, (19, 21)).astype(np.float64)
    supported = rng.random(label.shape) < 0.7
    image = rng.integers(0, 60, (*label.shape, 3)).astype(np.uint8)
    found = fitted_planes(label, supported, image, 1.0)
    for y, x in np.ndindex(label.shape):
        assert found[y, x] == pytest.approx(plain(label, supported, image, y, x), abs=1e-9)


def test_an_edge_stays() -> None:
    label = np.where(np.arange(30) < 15, 3.0, 9.0)[None].repeat(20, axis=0)
    image = np.full((20, 30, 3), 90, np.uint8)
    found = fitted_planes(label, np.ones(label.shape, bool), image, 1.0)
    np.testing.assert_allclose(found, label, atol=1e-9)
    rough = label + np.random.default_rng(1).uniform(-3, 3, label.shape)
    assert np.abs(fitted_planes(rough, label < 5, image, 1.0) - rough).max() == pytest.approx(
        completion.MAX_CHANGE_PX
    )


FEW = DisparityLabels(0.0, 1.0, 7)
CROSS = [(0.0, 0.0), (-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)]


@pytest.mark.nojit
@pytest.mark.parametrize("tolerance", [1, 2])
def test_kernel_is_its_twin(choose: Choose, rng: np.random.Generator, tolerance: int) -> None:
    far = np.where(rng.random((5, 9, 11)) < 0.6, 1.0, rng.integers(0, 7, (5, 9, 11)))
    maps = np.clip(far + 0.25 * rng.integers(-1, 2, far.shape), 0.0, 6.0)
    seen = rng.random(maps.shape) < 0.9
    moved = np.stack([shifts(FEW, LatticePosition(0.0, 0.0), LatticePosition(*place)) for place in CROSS])
    found = np.empty(maps.shape[1:])
    choose(completion._fuse)(0, maps, seen, moved, tolerance, found)
    np.testing.assert_array_equal(found, volumes.fused(0, maps, seen, moved, tolerance))
    refuted = found < maps[0] - tolerance
    assert refuted.any()
    assert (found[~refuted] != maps[0][~refuted]).any()


def test_surfaces_that_agree_stay() -> None:
    scene = reconstruction_of(SCENE, square_lattice(1), LABELS)
    maps = [LABELS.label(surface.disparity).astype(np.float64) for surface in scene.surfaces]
    for index, label in enumerate(maps):
        np.testing.assert_array_equal(fused(scene.array, LABELS, maps, index), label)


def test_what_one_camera_alone_has_wrong_is_put_right(rng: np.random.Generator) -> None:
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
    scene = reconstruction_of(SCENE, square_lattice(1)[:2], LABELS)
    maps = [rng.integers(0, LABELS.num_labels, scene.array.shape).astype(np.float64) for _ in range(2)]
    np.testing.assert_array_equal(fused(scene.array, LABELS, maps, 0), maps[0])


EIGHT_LABELS = DisparityLabels(0.0, 1.0, 8)


STRIPES = np.full((40, 64, 3), 12 * np.abs(np.arange(64) % 16 - 8)[:, None], np.uint8)
"""Vertical stripes: luma rises by 12 levels a pixel, and falls again."""
ROW = array_of(STRIPES, STRIPES)


def test_texture_counts_along_the_parallax() -> None:
    maps = [np.zeros((40, 64), np.int64)] * 2
    column = array_of(STRIPES, STRIPES, places=[(0.0, 0.0), (0.0, 1.0)])
    beside, below = (evidence(array, EIGHT_LABELS, maps, 0) for array in (ROW, column))
    # 12 levels a pixel but at the turns, where it is 0: one or two of fifteen
    np.testing.assert_allclose(np.asarray(beside.texture)[:, 16:48], np.log1p(12.0 * 13.5 / 15), atol=0.04)
    assert not np.asarray(below.texture).any()


def test_jumps_and_agreement_are_seen() -> None:
    own, other = np.full((40, 64), 2), np.full((40, 64), 2)
    own[:, 32:] = 6
    measured = evidence(ROW, EIGHT_LABELS, [own, other], 0)
    near = np.asarray(measured.near_jump)[20]
    assert near[31] == near[32] == 1.0
    np.testing.assert_allclose(near[[16, 47]], np.exp(-15.0 / 15.0), rtol=0.02)
    same = np.asarray(measured.agreement)
    np.testing.assert_array_equal(
        same, np.broadcast_to((np.arange(64) >= 2) & (np.arange(64) < 32), same.shape)
    )
    support = np.asarray(measured.support)[20]
    assert support[16] == pytest.approx(29 / 31, abs=0.04)
    assert support[47] == pytest.approx(0.0, abs=1e-6)
    flat = evidence(ROW, EIGHT_LABELS, [other, other], 0)
    assert not np.asarray(flat.near_jump).any()


def test_order_of_a_reconstruction() -> None:
    array, truth = figure.two_planes()
    found = reconstruct(array, figure.LABELS)
    for surface, disparity in zip(found.surfaces, truth, strict=True):
        bad = (np.abs(surface.disparity - disparity) > 1.0).ravel()
        area, _ = sparsification(bad, surface.confidence.ravel())
        assert area <= 50.0 * bad.mean()
