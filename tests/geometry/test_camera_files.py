"""Cameras as files: JSON, projection matrices, rows counted upwards, Middlebury's, COLMAP's; bad files."""

import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.errors import ConfigError, DvcError
from dvc.geometry.calibrated_cameras import Camera, camera_from_matrices, decomposed
from dvc.geometry.camera_files import load_cameras
from tests.stereo.rigs import random_rig

PICTURES = [np.zeros((120, 160, 3), np.uint8)] * 2
NAMES = ["folder/view0.png", "view1.png"]
MIDDLEBURY = """\
cam0=[1000 0 70; 0 1000 60; 0 0 1]
cam1=[1000 0 80; 0 1000 60; 0 0 1]
doffs=10
baseline=200
width=160
height=120
ndisp=40
isint=0
vmin=5
vmax=30
"""


def entry(camera: Camera) -> dict:
    return {"file": camera.name, "K": camera.K.tolist(), "R": camera.R.tolist(), "t": camera.t.tolist()}


def written(path: Path, document: object) -> Path:
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return path


@given(st.integers(0, 10**6), st.sampled_from([-3.0, 0.01, 1.0]))
def test_projection_matrices_are_decomposed(seed: int, scale: float) -> None:
    """(2.2): K, R and t come back from a matrix of any scale and sign; its centre is its null vector."""
    camera = random_rig(seed, [(0.0, 0.0)])[0]
    K, R, t = decomposed(scale * camera.projection)
    np.testing.assert_allclose(K, camera.K, atol=1e-9)
    np.testing.assert_allclose(R, camera.R, atol=1e-11)
    np.testing.assert_allclose(t, camera.t, atol=1e-10)
    np.testing.assert_allclose(camera.projection @ np.append(camera.centre, 1.0), 0.0, atol=1e-9)


@given(st.integers(0, 10**6))
def test_distortion_is_undone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = random_rig(seed, [(0.0, 0.0)])[0]
    k1, k2, p1, p2 = rng.uniform(-1, 1, 4) * (0.1, 0.02, 0.005, 0.005)
    camera = Camera(camera.name, camera.K, camera.R, camera.t, camera.size, (k1, k2, p1, p2))
    points = rng.uniform(0, 1, (20, 2)) * camera.size
    np.testing.assert_allclose(camera.undistorted(camera.distorted(points)), points, atol=1e-6)


def test_distortion_that_folds_the_picture_is_refused() -> None:
    camera = random_rig(0, [(0.0, 0.0)])[0]
    camera = Camera(camera.name, camera.K, camera.R, camera.t, camera.size, (-9.0, 0.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match="too strong"):
        camera.undistorted(np.array([[0.0, 0.0], [80.0, 60.0]]))


def test_radial_distortion_is_as_documented() -> None:
    camera = Camera("a", np.diag([100.0, 100.0, 1.0]), np.eye(3), np.zeros(3), (9, 9), (0.2, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(camera.distorted(np.array([[50.0, 0.0]])), [[50.0 * (1 + 0.2 * 0.25), 0.0]])


def test_json_of_matrices_and_points(tmp_path: Path) -> None:
    first, second = random_rig(1, [(0.0, 0.0), (1.0, 0.0)])
    entries = [{"file": "view1.png", "P": second.projection.tolist(), "distortion": [0.01]}, entry(first)]
    path = written(tmp_path / "c.json", {"cameras": entries, "points": [[1, 2, 3]]})
    views = load_cameras(path, NAMES, PICTURES)
    np.testing.assert_allclose(views.cameras[0].K, first.K)
    np.testing.assert_allclose(views.cameras[1].projection, second.projection, atol=1e-8)
    assert views.cameras[1].distortion == (0.01, 0.0, 0.0, 0.0)
    np.testing.assert_array_equal(views.points, [[1.0, 2.0, 3.0]])


def test_rows_counted_upwards_are_mirrored() -> None:
    rig = random_rig(2, [(0.0, 0.0)])[0]
    camera = camera_from_matrices(rig.name, rig.K, rig.R, rig.t, rig.size, bottom_up=True)
    point = rig.centre + 5 * rig.R[2] + np.array([0.3, -0.2, 0.1])
    u, v, w = rig.projection @ np.append(point, 1.0)
    a, b, c = camera.projection @ np.append(point * [1, -1, 1], 1.0)
    assert c == pytest.approx(w)
    np.testing.assert_allclose([a / c, b / c], [u / w, 119 - v / w])
    assert np.linalg.det(camera.R) == pytest.approx(1.0)


@pytest.mark.parametrize("end", ["\n", "\r\n"], ids=["lf", "crlf"])
def test_middlebury_calibration(end: str, tmp_path: Path) -> None:
    (tmp_path / "calib.txt").write_bytes(MIDDLEBURY.replace("\n", end).encode())
    views = load_cameras(tmp_path / "calib.txt", ["im0.png", "im1.png"], PICTURES)
    for z, d in zip(views.points[:, 2], (5.0, 30.0), strict=True):
        seen = [camera.projection @ [3.0, 4.0, z, 1.0] for camera in views.cameras]
        (xl, yl), (xr, yr) = (image[:2] / image[2] for image in seen)
        assert yl == pytest.approx(yr)
        assert xl - xr == pytest.approx(d)


def write_model(tmp_path: Path) -> None:
    """Write a COLMAP model of two views in text form."""
    (tmp_path / "cameras.txt").write_text("1 SIMPLE_RADIAL 160 120 150 80.5 60.5 0.02\n")
    images = "".join(f"{k + 1} 1 0 0 0 {-k} 0 0 1 view{k}.png\n10 20 1\n" for k in range(2))
    (tmp_path / "images.txt").write_text(images)
    (tmp_path / "points3D.txt").write_text("1 0.5 0.25 7 0 0 0 0.1 1 0 2 0\n")
    (tmp_path / "rigs.txt").write_text("1 1 CAMERA 1\n")
    (tmp_path / "frames.txt").write_text(
        "".join(f"{k} 1 1 0 0 0 {1 - k} 0 0 1 CAMERA 1 {k}\n" for k in (1, 2))
    )


def test_colmap_model(tmp_path: Path) -> None:
    write_model(tmp_path)
    views = load_cameras(tmp_path, NAMES, PICTURES)
    np.testing.assert_allclose(views.cameras[0].K, [[150, 0, 80], [0, 150, 60], [0, 0, 1]])
    np.testing.assert_allclose(views.cameras[1].centre, [1, 0, 0], atol=1e-12)
    assert views.cameras[1].distortion == (0.02, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(views.points, [[0.5, 0.25, 7.0]])


REFLECTION = np.diag([1.0, -1.0, 1.0]).tolist()
GOOD = [entry(camera) for camera in random_rig(3, [(0.0, 0.0), (1.0, 0.0)])]


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (GOOD[:1], "has no camera of view1.png"),
        ([*GOOD, GOOD[0]], "named twice"),
        ([GOOD[0], {**GOOD[1], "R": REFLECTION}], "reflection.*bottom-up"),
        ([GOOD[0], {**GOOD[1], "R": (2 * np.eye(3)).tolist()}], "not a rotation"),
        ([GOOD[0], {**GOOD[1], "K": np.ones((3, 3)).tolist()}], "upper triangular"),
        ([GOOD[0], {**GOOD[1], "t": [0, 0]}], "expected a list of cameras"),
        ([GOOD[0], {**GOOD[1], "t": [0, 0, float("nan")]}], "not finite"),
        ([GOOD[0], {"file": "view1.png"}], "expected a list of cameras"),
        ([GOOD[0], {"file": "view1.png", "P": np.ones((3, 4)).tolist()}], "no finite centre"),
        ([GOOD[0], {"file": "view1.png", "P": np.zeros((3, 4)).tolist()}], "not finite, or zero"),
        ([GOOD[0], {**GOOD[1], "t": [0, 0, 1e200]}], "numbers beyond 1e[+]12"),
        ([GOOD[0], {**GOOD[1], "K": np.diag([1e-5, 1.0, 1.0]).tolist()}], "no lens"),
        ([GOOD[0], {**GOOD[1], "rows": "sideways"}], "top-down"),
        ([GOOD[0], {**GOOD[1], "distortion": [0] * 5}], "at most k1"),
        ([1, 2], "expected a list of cameras"),
        ("[1, 2", "expected a list of cameras"),
        ("P2 nonsense", "not a JSON file"),
        (MIDDLEBURY.replace("width=160", "width=161"), "160x120, but .* is for 161x120"),
        (MIDDLEBURY.replace("baseline=200", ""), "expected cam0"),
        (MIDDLEBURY.replace("0 0 1]", "0 1]"), "expected cam0"),
    ],
)
def test_wrong_files_say_what_is_wrong(tmp_path: Path, document: object, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_cameras(written(tmp_path / "cameras", document), NAMES, PICTURES)


def test_folder_without_a_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no COLMAP model"):
        load_cameras(tmp_path, NAMES, PICTURES)
    (tmp_path / "cameras.bin").write_bytes(b"\x01\x02")
    with pytest.raises(DvcError, match="not a COLMAP model"):
        load_cameras(tmp_path, NAMES, PICTURES)


@pytest.mark.parametrize(
    ("name", "offset"),
    [("cameras", 0), ("images", 0), ("images", 82), ("points3D", 0), ("points3D", 51), ("frames", 0)],
)
def test_counts_beyond_binary_files_are_refused(tmp_path: Path, name: str, offset: int) -> None:
    text, binary = tmp_path / "text", tmp_path / "binary"
    for folder in (text, binary):
        folder.mkdir()
    write_model(text)
    pycolmap.Reconstruction(text).write_binary(binary)
    assert len(load_cameras(binary, NAMES, PICTURES).cameras) == 2
    content = bytearray((binary / f"{name}.bin").read_bytes())
    content[offset : offset + 8] = (1 << 33).to_bytes(8, "little")
    (binary / f"{name}.bin").write_bytes(content)
    with pytest.raises(DvcError, match="not a COLMAP model"):
        load_cameras(binary, NAMES, PICTURES)


def test_cameras_of_blank_pictures_cannot_be_estimated() -> None:
    for count in (2, 3):
        with pytest.raises(DvcError, match=f"{'two' if count == 2 else count} views cannot be estimated"):
            load_cameras("auto", [f"{k}.png" for k in range(count)], PICTURES[:1] * count)
    with pytest.raises(ConfigError, match="one size"):
        load_cameras("auto", NAMES, [PICTURES[0], PICTURES[0][:50]])
