"""The rendered camera array: its lattice, its files, and pictures that depth and cameras explain."""

import json
from pathlib import Path

import numpy as np
import pytest

from dvc.array_files import read_positions
from dvc.picture_files import read_pfm, read_picture
from sequences.__main__ import main
from sequences.scene_cameras import back_project, project
from sequences.scene_layouts import POSITIONS, STEP_DOWN_M, STEP_RIGHT_M
from sequences.toy_array import render_view


def test_centres_form_a_lattice_of_cells_that_are_not_square() -> None:
    """Steps differ in length, axes are not parallel."""
    views = [render_view("toy", index, 16, 12) for index in range(4)]
    centres = np.stack([view.camera.centre for view in views])
    steps = (centres - centres[0]).round(12)
    np.testing.assert_allclose(steps[1], [STEP_RIGHT_M, 0, 0], atol=1e-12)
    np.testing.assert_allclose(steps[2], [0, 0, -STEP_DOWN_M], atol=1e-12)
    np.testing.assert_allclose(steps[3], steps[1] + steps[2], atol=1e-12)
    axes = np.stack([view.camera.cam_from_world[2, :3] for view in views])
    assert (axes @ axes.T)[~np.eye(4, dtype=bool)].max() < np.cos(np.radians(1.0))


def test_depth_and_cameras_explain_the_pictures() -> None:
    """Points that are visible in two views look alike."""
    first, second = render_view("toy", 0), render_view("toy", 3)
    assert np.isfinite(first.depth).all()
    y, x = np.mgrid[4:240:8, 4:320:8]
    pixels = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    points = back_project(first.camera, pixels, first.depth[y, x].ravel().astype(np.float64))
    seen, depth = project(second.camera, points)
    u, v = np.rint(seen).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < 320) & (v < 240)
    u, v = u[inside], v[inside]
    visible = np.abs(second.depth[v, u] / depth[inside] - 1) < 0.01
    assert 0.6 < visible.mean() < 0.99
    colours = first.image[y, x].reshape(-1, 3)[inside].astype(float)
    assert np.median(np.abs(colours - second.image[v, u])[visible]) < 12


def test_command_writes_pictures_depth_and_cameras(tmp_path: Path) -> None:
    """The folder is an input of `dvc-stereo`."""
    folder = tmp_path / "toy"
    assert main(["render", "toy", "--out", str(folder), "--size", "32x24"]) == 0
    cameras = json.loads((folder / "cameras.json").read_text())
    assert [camera["file"] for camera in cameras] == [f"toy-{m}-{n}.png" for m, n in POSITIONS]
    for camera in cameras:
        assert np.linalg.det(camera["R"]) == pytest.approx(1.0)
        assert read_picture(folder / camera["file"]).shape == (24, 32, 3)
        assert read_pfm(folder / f"depth-{Path(camera['file']).stem}.pfm").shape == (24, 32)
    assert list(read_positions(folder / "views.csv").values()) == [tuple(map(float, p)) for p in POSITIONS]


@pytest.mark.parametrize("option", [("--frames", "3"), ("--noise", "1"), ("--depth", "d")])
def test_options_of_videos_are_refused(
    tmp_path: Path, option: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Options without effect are errors."""
    assert main(["render", "toy", "--out", str(tmp_path / "toy"), *option]) == 2
    assert f"{option[0]} applies to videos" in capsys.readouterr().err
    assert not (tmp_path / "toy").exists()
