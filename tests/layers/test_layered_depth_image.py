"""Layered depth images (2.21) of scenes with known surfaces."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_fill_holes

from dvc.errors import DvcError
from dvc.geometry.camera_array import ArrayView, CameraArray, DisparityLabels, Reconstruction, Surface
from dvc.layers.layered_depth_image import (
    LayeredDepthImage,
    _neighbours,
    _without_strays,
    layered_depth_image,
    resolution,
    unrefuted,
)
from tests.stereo.plane_scenes import (
    BACKGROUND,
    LABELS,
    SCENE,
    Plane,
    colour_of,
    reconstruction_of,
    square_lattice,
)

PAIR = [(0.0, 0.0), (1.0, 0.0)]


def _check(image: LayeredDepthImage) -> None:
    occupied = image.occupied
    assert not (occupied[1:] & ~occupied[:-1]).any()
    steps = (image.disparity[:-1] - image.disparity[1:])[occupied[1:]]
    assert (steps > 0.99 * image.canvas.labels.step).all()
    assert occupied[0, *image.canvas.frame.slices].all()
    assert occupied[-1].any()


def _changed(reconstruction: Reconstruction, disparities: list[np.ndarray]) -> Reconstruction:
    surfaces = zip(reconstruction.surfaces, disparities, strict=True)
    new = tuple(Surface(d.astype(np.float32), s.occluded, s.confidence) for s, d in surfaces)
    return Reconstruction(reconstruction.array, reconstruction.labels, new)


def test_one_camera() -> None:
    reconstruction = reconstruction_of(SCENE, PAIR[:1], LABELS)
    image = layered_depth_image(reconstruction)
    assert image.votes.shape == (1, 40, 60)
    np.testing.assert_array_equal(image.disparity[0], reconstruction.surfaces[0].disparity)
    np.testing.assert_array_equal(image.colour[0], reconstruction.array[0].image)
    assert (image.votes == 1).all()
    assert image.counts()["increase_percent"] == 0.0


def test_all_cameras_vote_for_what_all_see() -> None:
    reconstruction = reconstruction_of(SCENE, square_lattice(1), LABELS)
    image = layered_depth_image(reconstruction)
    _check(image)
    rows, columns = image.canvas.frame.slices
    votes = image.votes[0, rows, columns]
    assert (votes[10:24, 26:34] == 9).all()
    assert votes.max() == 9
    np.testing.assert_array_equal(image.disparity[0, rows, columns], reconstruction.surfaces[0].disparity)


def test_neighbours_are_the_nearest_of_a_row_and_of_a_column() -> None:
    positions = square_lattice(2)
    array = reconstruction_of(SCENE, positions, LABELS).array
    for place, expected in (
        ((0.0, 0.0), [{(-1.0, 0.0), (1.0, 0.0)}, {(0.0, -1.0), (0.0, 1.0)}]),
        ((2.0, -2.0), [{(1.0, -2.0)}, {(2.0, -1.0)}]),
    ):
        found = _neighbours(array, positions.index(place))
        assert [{positions[k] for k in pair} for pair in found] == expected


def test_hidden_surfaces_are_found_with_their_colours() -> None:
    reconstruction = reconstruction_of(SCENE, square_lattice(2), LABELS)
    image = layered_depth_image(reconstruction)
    _check(image)
    assert len(image.votes) == 3
    frame = image.canvas.frame
    y, x = np.indices(image.canvas.shape, np.float64)
    for layer, row, column in np.argwhere(image.occupied):
        number = [2.0, 6.0, 10.0].index(image.disparity[layer, row, column])
        place = np.array([x[row, column] - frame.left]), np.array([y[row, column] - frame.top])
        assert (image.colour[layer, row, column] == colour_of(number, *place)[0]).all()


def test_more_cameras_see_more() -> None:
    positions = square_lattice(2)
    counts = []
    for number in (1, 2, 3, 5, 9, 13, 25):
        image = layered_depth_image(reconstruction_of(SCENE, positions[:number], LABELS))
        counts.append((image.counts()["num_values_inside"], image.counts()["num_values_beyond"]))
    assert counts == sorted(counts)
    assert (np.diff(counts, axis=0) >= 0).all()
    assert counts[0] == (2400, 0)
    assert counts[1][0] > 2400


def test_two_cameras_see_the_strips_beside_a_surface() -> None:
    for label in (6, 3):
        front = Plane(float(label), (20, 40), (10, 30))
        image = layered_depth_image(reconstruction_of((BACKGROUND, front), PAIR, LABELS))
        assert image.counts()["num_values_by_layer"] == [2400, (label - 2) * 20]
        assert image.counts()["num_values_beyond"] == 40 * 2
        assert set(image.disparity[1][image.occupied[1]]) == {2.0}


def test_disagreement_by_a_label_makes_no_layer() -> None:
    reconstruction = reconstruction_of((Plane(6.0),), square_lattice(1), LABELS)
    wrong = [surface.disparity + k % 2 for k, surface in enumerate(reconstruction.surfaces)]
    image = layered_depth_image(_changed(reconstruction, wrong))
    assert len(image.votes) == 1


def test_what_is_seen_through_does_not_vote() -> None:
    reconstruction = reconstruction_of((BACKGROUND,), PAIR, LABELS)
    wrong = [surface.disparity.copy() for surface in reconstruction.surfaces]
    wrong[1][10:20, 20:30] = 9.0
    changed = _changed(reconstruction, wrong)
    assert not unrefuted(changed)[1][10:20, 20:30].any()
    assert layered_depth_image(changed).counts()["num_layers"] == 1


def test_the_reference_sees_its_first_surface_only() -> None:
    reconstruction = reconstruction_of((Plane(6.0),), [(float(m), 0.0) for m in range(-2, 3)], LABELS)
    wrong = [surface.disparity.copy() for surface in reconstruction.surfaces]
    wrong[2][10:20, 20:30] = 2.0
    image = layered_depth_image(_changed(reconstruction, wrong))
    assert len(image.votes) == 1
    assert (image.disparity[image.occupied] == 6.0).all()
    first = image.colour[0, *image.canvas.frame.slices]
    np.testing.assert_array_equal(first, reconstruction.array[2].image)


@pytest.mark.parametrize("slope", [0.15, -0.15])
@pytest.mark.parametrize("m", [2.6, -2.6])
def test_slanted_surfaces_have_no_pinholes(m: float, slope: float) -> None:
    labels = DisparityLabels(-10.0, 0.25, 100)
    truth = reconstruction_of((Plane(3.3, slope=slope),), [(0.0, 0.0), (m, 0.7)], labels)
    blind = ArrayView("blind", truth.array[0].image, truth.array[0].position, np.zeros((40, 60), np.bool_))
    array = CameraArray((blind, truth.array[1]))
    image = layered_depth_image(Reconstruction(array, labels, truth.surfaces))
    assert len(image.votes) == 1
    np.testing.assert_array_equal(image.occupied[0], binary_fill_holes(image.occupied[0]))
    assert image.occupied.sum() == pytest.approx(40 * 60 / (1.0 - m * slope), rel=0.06)
    _, x = np.indices(image.canvas.shape)
    expected = 3.3 + slope * (x - image.canvas.frame.left)
    assert np.abs(image.disparity[0] - expected)[image.occupied[0]].max() <= 0.5 * abs(slope) + 1e-4


def test_positions_and_disparities_between_whole_numbers() -> None:
    labels = DisparityLabels(-2.0, 0.25, 20)
    scene = Plane(-1.5, slope=0.004), Plane(2.1, (20, 40), (10, 30))
    image = layered_depth_image(reconstruction_of(scene, [(0.0, 0.0), (2.3, 0.2), (-1.9, -0.4)], labels))
    _check(image)
    assert len(image.votes) == 2
    assert set(np.unique(image.votes[0, *image.canvas.frame.slices][12:28, 22:38])) == {3}
    hidden = image.disparity[1][image.occupied[1]]
    assert np.abs(hidden + 1.5 - 0.004 * 30).max() < 0.1
    assert hidden.size > 2 * 3.0 * 15


@given(seed=st.integers(0, 2**32 - 1), num_cameras=st.integers(1, 6))
def test_any_surfaces(seed: int, num_cameras: int) -> None:
    rng = np.random.default_rng(seed)
    reconstruction = reconstruction_of((BACKGROUND,), square_lattice(1)[:num_cameras], LABELS, (9, 11))
    shape = len(reconstruction.array), 9, 11
    image = layered_depth_image(_changed(reconstruction, list(rng.integers(0, 12, shape))))
    _check(image)
    first = image.colour[0, *image.canvas.frame.slices]
    np.testing.assert_array_equal(first, reconstruction.array[reconstruction.array.reference].image)


def test_strays_behind_two_surfaces_are_dropped() -> None:
    votes = np.zeros((4, 12, 12), np.uint8)
    votes[0], votes[1, 3:5, 3:5], votes[2, :5, :4], votes[2, 8:, 8:], votes[3, 9:, 9:] = 5, 4, 3, 2, 1
    disparity = np.where(votes > 0, 10.0 * np.arange(1, 5)[:, None, None], 0.0).astype(np.float32)
    colour = np.repeat(disparity[..., None], 3, axis=-1).astype(np.uint8)
    expected = votes[:3].copy()
    expected[2, 8:, 8:] = 0
    found_colour, found_disparity, found = _without_strays(colour.copy(), disparity.copy(), votes.copy())
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(found_disparity, np.where(expected > 0, disparity[:3], 0.0))
    np.testing.assert_array_equal(found_colour[..., 0], found_disparity)


def test_resolution() -> None:
    array = reconstruction_of((BACKGROUND,), [(-4.0, 0.0), (4.0, 2.0)], LABELS).array
    assert resolution(array, LABELS) == 1.0
    assert resolution(array, DisparityLabels(0.0, 0.01, 9)) == 1 / 8


@pytest.mark.parametrize(
    ("step", "scale", "message"),
    [
        (1e-300, 1.0, "out of range"),
        (1e300, 1.0, "out of range"),
        (1.0, 1e30, "out of range"),
        (1.0, 1e3, "at most 16 times a view"),
    ],
)
def test_magnitudes_out_of_range(step: float, scale: float, message: str) -> None:
    reconstruction = reconstruction_of((BACKGROUND,), PAIR, DisparityLabels(0.0, step, 12))
    wrong = [surface.disparity * scale for surface in reconstruction.surfaces]
    with pytest.raises(DvcError, match=message):
        layered_depth_image(_changed(reconstruction, wrong))


@pytest.mark.parametrize("matrix", [[1], [[10**400]], np.zeros((4, 4)).tolist(), np.eye(4).tolist(), None])
def test_rectification_without_homography(matrix: object) -> None:
    found = reconstruction_of((BACKGROUND,), PAIR, LABELS)
    figures = {"rectification": {"rectified_from_world": matrix}}
    with pytest.raises(DvcError, match="homography of space"):
        layered_depth_image(Reconstruction(found.array, LABELS, found.surfaces, figures))


def test_homography_of_space() -> None:
    found = reconstruction_of((BACKGROUND,), [(2.0, -1.0), (3.0, -1.0)], LABELS)
    rectified_from_world = np.array([[30.0, 0, 9, 0], [0, 30, 5, 0], [0, 0, 0, 12], [0, 0, 1, 0]])
    figures = {"rectification": {"rectified_from_world": rectified_from_world.tolist()}}
    image = layered_depth_image(Reconstruction(found.array, LABELS, found.surfaces, figures))
    points = image.canvas.points(image.disparity[0])[*image.canvas.frame.slices]
    y, x = np.indices((40, 60))
    expected = np.stack([x + 2.0 * 2 - 9, y - 1.0 * 2 - 5, np.full((40, 60), 30.0)], axis=-1) * 6.0 / 30.0
    np.testing.assert_allclose(points, expected, atol=1e-9)
    np.testing.assert_allclose(image.canvas.depth_scale.depth(np.array([2.0, 4.0])), [6.0, 3.0])


def test_surfaces_that_fold_all_over_are_refused() -> None:
    reconstruction = reconstruction_of((BACKGROUND,), [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)], LABELS)
    rng = np.random.default_rng(4)
    noise = [150.0 * rng.integers(0, 2, surface.disparity.shape) for surface in reconstruction.surfaces]
    surfaces, labels = _changed(reconstruction, noise).surfaces, DisparityLabels(0.0, 150.0, 2)
    with pytest.raises(DvcError, match="at most 16 a pixel"):
        layered_depth_image(Reconstruction(reconstruction.array, labels, surfaces, {}))
