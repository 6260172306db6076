"""From pictures to rectified views: the rendered array, the real sets against OpenCV, ranges, bad input."""

import json
from dataclasses import replace
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.pictures.stereo import write_cameras
from dvc.errors import ConfigError, DvcError
from dvc.geometry.calibrated_cameras import Camera
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.camera_estimation import Features
from dvc.geometry.camera_files import load_cameras
from dvc.picture_files import read_pfm, read_picture
from dvc.stereo.rectification.rectified_array import (
    RectifiedArray,
    RowMatches,
    range_of,
    range_of_matches,
    rectified_array,
    rectify,
    refined_pair,
    row_matches,
    suggested_labels,
)
from dvc.stereo.rectification.rectified_space import MAX_RESAMPLED_SIDE, Rectification
from sequences.rendered_sequence import write_array
from tests.stereo.data import real_set
from tests.stereo.rigs import random_rig, rays_of


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Render the toy array."""
    folder = tmp_path_factory.mktemp("array") / "toy"
    write_array("toy", folder)
    return folder


PLACES = [(0, 0), (0, 1), (1, 0), (1, 1)]


def views_of(folder: Path) -> list[Path]:
    return sorted(folder.glob("toy-*.png"))


def rms_of(found: RectifiedArray) -> float:
    """Return the error of rows of matches."""
    assert found.matches is not None
    assert found.matches.rms_px is not None
    return found.matches.rms_px


def test_toy_is_rectified_to_its_lattice(toy: Path) -> None:
    """Places are found, rows and columns of matches agree, and the range holds the true disparities."""
    found = rectified_array(views_of(toy), toy / "cameras.json")
    assert [tuple(p) for p in found.rectification.positions] == PLACES
    assert rms_of(found) < 0.4
    assert found.off_plane_px.max() < 1e-6
    labels = found.labels
    assert labels is not None
    for index, path in enumerate(views_of(toy)):
        truth = true_disparity(toy, path, found.rectification, index)
        assert labels.lowest <= np.quantile(truth, 0.01)
        assert np.quantile(truth, 0.99) <= labels.highest


def true_disparity(toy: Path, path: Path, rectification: Rectification, index: int) -> np.ndarray:
    camera = rectification.cameras[index]
    depth = read_pfm(toy / f"depth-{path.stem}.pfm").astype(np.float64)
    points = rays_of(camera) * depth.reshape(-1, 1) + camera.centre
    return rectification.disparities(points).reshape(depth.shape)


def test_cameras_of_toy_are_estimated(toy: Path) -> None:
    found = rectified_array(views_of(toy), "auto", with_matches=True)
    places = np.array(found.rectification.positions)
    np.testing.assert_allclose(places - places[0], PLACES, atol=0.05)
    assert rms_of(found) < 0.5
    assert found.labels is not None
    again = rectified_array(views_of(toy), "auto")
    assert again.rectification.to_dict() == found.rectification.to_dict()


def test_two_views_of_toy_are_estimated(toy: Path) -> None:
    paths = views_of(toy)
    found = rectified_array([paths[0], paths[2]], "auto")
    assert [tuple(position) for position in found.rectification.positions] == [(0, 0), (1, 0)]
    assert rms_of(found) < 0.5


def rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


def rows_off(found: Rectification, first: np.ndarray, second: np.ndarray) -> float:
    """Return the error of rows of matches between two views."""
    return rms((found.rectified_points(0, first) - found.rectified_points(1, second))[:, 1])


def opencv_rows(cameras: tuple[Camera, ...], first: np.ndarray, second: np.ndarray) -> np.ndarray:
    a, b = cameras
    R = b.R @ a.R.T
    none = np.zeros(5)
    turns = cv2.stereoRectify(a.K, none, b.K, none, a.size, R, (b.t - R @ a.t)[:, None], alpha=-1)
    rows = [
        cv2.undistortPoints(points[:, None], camera.K, none, R=turns[k], P=turns[2 + k])[:, 0, 1]
        for k, (camera, points) in enumerate(((a, first), (b, second)))
    ]
    return rows[0] - rows[1]


@pytest.mark.parametrize("name", ["sport", "ballet"])
def test_rows_agree_better_than_those_of_opencv(name: str, tmp_path: Path) -> None:
    """Of real verging cameras, rows of matches differ less than after `cv2.stereoRectify`."""
    folder = real_set(name)
    file = tmp_path / "cameras.json"
    paths = write_cameras(folder, file)
    pictures = [read_picture(path) for path in paths]
    matched = Features(pictures[0]).match(Features(pictures[1]))
    _, inliers = cv2.findFundamentalMat(*matched, cv2.USAC_MAGSAC, 1.5, 0.9999, 20000)
    first, second = (points[inliers.ravel() > 0] for points in matched)
    given = load_cameras(file, paths, pictures).cameras
    theirs = rms(opencv_rows(given, first, second))
    assert rows_off(rectified_array(paths, file).rectification, first, second) < theirs
    kept = rectified_array(paths, file, keep_cameras=True).rectification
    scale = kept.focal_length_px / min(camera.K[1, 1] for camera in given)
    assert rows_off(kept, first, second) <= 1.02 * scale * theirs


def test_fern_has_real_places_near_its_irregular_grid(tmp_path: Path) -> None:
    """Twenty hand-held cameras: real-valued places, nearly a plane, rows and columns that agree."""
    paths = write_cameras(real_set("fern"), tmp_path / "cameras.json")
    found = rectified_array(paths, tmp_path / "cameras.json", with_matches=True)
    places = np.array(found.rectification.positions)
    assert np.abs(places - np.rint(places)).max() > 0.2
    assert found.off_plane_px.max() < 6.0
    assert rms_of(found) < 0.8
    assert found.array.shape[0] < 2 * 378
    assert found.array.shape[1] < 2 * 504


def test_tilted_calibration_is_put_right() -> None:
    rig = random_rig(21, [(0.0, 0.0), (1.0, 0.0)], turn=0.05)
    rng = np.random.default_rng(0)
    middle = np.mean([camera.centre for camera in rig], axis=0)
    forward = np.mean([camera.R[2] for camera in rig], axis=0)
    points = middle + rng.uniform(6, 20, (200, 1)) * (forward + rng.uniform(-0.25, 0.25, (200, 3)))
    seen = [np.column_stack([points, np.ones(200)]) @ camera.projection.T for camera in rig]
    first, second = (image[:, :2] / image[:, 2:] for image in seen)
    assert refined_pair(rig, first, second) == tuple(rig)
    turn = Rotation.from_rotvec(np.radians([0.5, 0.0, 0.4])).as_matrix()
    wrong = replace(rig[1], R=turn @ rig[1].R, t=-turn @ rig[1].R @ rig[1].centre)
    fixed = rectify(refined_pair([rig[0], wrong], first, second))
    assert rows_off(fixed, first, second) < 0.15


def test_labels_hold_the_range_in_steps_that_suit_it() -> None:
    for low, high, step in ((0.0, 60.0, 1.0), (-3.0, 2.5, 0.5), (0.0, 0.5, 0.125), (0.0, 9000.0, 4.0)):
        labels = suggested_labels(low, high)
        assert labels.step == step
        assert labels.lowest < low < high < labels.highest
        assert 16 <= labels.num_labels <= 4096


def test_cameras_off_the_plane_are_reported_in_pixels(toy: Path, tmp_path: Path) -> None:
    cameras = json.loads((toy / "cameras.json").read_text())
    cameras[3]["t"] = (np.array(cameras[3]["t"]) - [0, 0, 0.3]).tolist()
    moved = tmp_path / "moved.json"
    moved.write_text(json.dumps(cameras))
    with pytest.raises(DvcError, match=r"are not in a plane: toy-\d-\d\.png is off by up to [\d.]+ px"):
        rectified_array(views_of(toy), moved)


def test_given_places_are_kept_or_become_real(toy: Path) -> None:
    """Mirrored places are turned to the scene; a place that is wrong by half a cell is found."""
    mirrored = [LatticePosition(float(m), -float(n)) for m in (0, 1) for n in (0, 1)]
    found = rectified_array(views_of(toy), toy / "cameras.json", mirrored)
    assert [tuple(p) for p in found.rectification.positions] == PLACES
    wrong = [LatticePosition(*place) for place in ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.5, 1.0))]
    found = rectified_array(views_of(toy), toy / "cameras.json", wrong)
    assert np.array(found.rectification.positions).round(3).tolist() != [list(p) for p in wrong]
    with pytest.raises(ConfigError, match="4 views and 2 positions"):
        rectified_array(views_of(toy), toy / "cameras.json", wrong[:2])


def test_pictures_of_several_sizes_are_rectified_to_one(toy: Path, tmp_path: Path) -> None:
    cameras = json.loads((toy / "cameras.json").read_text())
    half = np.array([[0.5, 0, -0.25], [0, 0.5, -0.25], [0, 0, 1.0]])
    cameras[1]["K"] = (half @ np.array(cameras[1]["K"])).tolist()
    (tmp_path / "cameras.json").write_text(json.dumps(cameras))
    paths = [tmp_path / camera["file"] for camera in cameras]
    for index, path in enumerate(paths):
        picture = cv2.imread(str(toy / path.name))
        if index == 1:
            picture = cv2.resize(picture, (160, 120), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(path), picture)
    found = rectified_array(paths, tmp_path / "cameras.json")
    assert rms_of(found) < 0.5
    assert len({view.shape for view in found.array}) == 1


def test_views_that_cannot_be_resampled_are_refused(toy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert MAX_RESAMPLED_SIDE == 2**15 - 2
    monkeypatch.setattr("dvc.stereo.rectification.rectified_array.MAX_RESAMPLED_SIDE", 100)
    with pytest.raises(ConfigError, match="pixels, sides of at most 100"):
        rectified_array(views_of(toy), toy / "cameras.json")


class Seen:
    """Points of one view with known disparities; the last one has a wrong match in every other view."""

    def __init__(self, position: LatticePosition, disparities: np.ndarray) -> None:
        self.position, self.disparities, self.partners = position, disparities, list[LatticePosition]()

    def points(self) -> np.ndarray:
        """Return the positions of the points (2.5)."""
        rows = np.linspace(100.0, 200.0, len(self.disparities))
        moved = np.outer(self.disparities, [self.position.m, self.position.n])
        return np.stack([2.0 * rows, rows], axis=1) - moved

    def match(self, other: "Seen") -> tuple[np.ndarray, np.ndarray]:
        """Return the same points in both views."""
        self.partners.append(other.position)
        here, there = self.points(), other.points()
        apart = np.subtract(other.position, self.position)
        there[-1] += 3.0 * np.array([-apart[1], apart[0]]) / np.hypot(*apart)
        return here, there


def test_reference_is_matched_with_its_neighbours() -> None:
    """The view nearest to the origin with the eight next to it; matches across the parallax are left out."""
    positions = [LatticePosition(m, n) for m in (14.0, 11.0, 12.0, 13.0) for n in (-3.0, -2.0, -1.0, -4.0)]
    disparities = np.array([0.5, 2.0, 7.0, 4.0, 30.0])
    seen = [Seen(position, disparities) for position in positions]
    found = row_matches(positions, cast(list[Features], seen))
    reference = seen[positions.index(LatticePosition(11.0, -1.0))]
    assert [bool(one.partners) for one in seen] == [one is reference for one in seen]
    distances = np.sort([np.hypot(*np.subtract(one, reference.position)) for one in positions])
    chosen = [np.hypot(*np.subtract(one, reference.position)) for one in reference.partners]
    np.testing.assert_allclose(chosen, distances[1:9])
    np.testing.assert_allclose(found.disparities, np.tile(disparities[:-1], 8))
    np.testing.assert_allclose(found.residuals_px, 0.0, atol=1e-9)
    assert range_of_matches(found) is not None


def test_few_matches_give_no_range() -> None:
    values = np.linspace(1.0, 9.0, 20)
    assert range_of_matches(RowMatches(values, np.zeros(20))) is not None
    assert range_of_matches(RowMatches(values[1:], np.zeros(19))) is None
    assert RowMatches(values, np.array([3.0, -4.0])).rms_px == np.sqrt(12.5)
    assert RowMatches(values[:0], np.zeros(0)).rms_px is None


def test_wrong_matches_hardly_widen_the_range() -> None:
    true = np.linspace(20.0, 60.0, 188)
    wrong = np.concatenate([np.full(6, -3000.0), np.full(6, 5000.0)])
    np.testing.assert_allclose(range_of(true), (20.4, 59.6), atol=0.05)
    lowest, highest = range_of(np.concatenate([true, wrong]))
    assert -20.0 < lowest <= 20.4
    assert 59.6 <= highest < 100.0
    labels = suggested_labels(*range_of(true))
    assert 10.0 < labels.lowest < 15.0
    assert 70.0 < labels.highest < 77.0
    assert labels.step == 1.0
