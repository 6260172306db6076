"""`dvc-stereo layers` and `dvc-stereo sprites`: files, counts and refusals."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.thesis.chapter2 import draw_surfaces
from dvc.layers.layer_folders import read_layers, read_sprites, write_layers
from dvc.layers.layered_depth_image import layered_depth_image
from dvc.stereo.layer_commands import PAPER, draw_layers, draw_values_per_pixel
from dvc.stereo.surfaces.surface_folder import write_reconstruction
from tests.stereo.data import check_refused, run
from tests.stereo.plane_scenes import LABELS, SCENE, reconstruction_of, square_lattice

COUNTS = {"num_layers", "num_values_inside", "num_values_beyond", "increase_percent", "num_values_by_layer"}


@pytest.fixture
def surfaces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write the surfaces of three planes, and change to the folder above."""
    folder = tmp_path / "surfaces"
    folder.mkdir()
    write_reconstruction(folder, reconstruction_of(SCENE, square_lattice(1), LABELS))
    monkeypatch.chdir(tmp_path)
    return folder


def test_layers(surfaces: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("layers", "surfaces", "--out", "layers", "--json", "-") == 0
    counts = json.loads(capsys.readouterr().out)
    assert set(counts) == COUNTS
    image = read_layers("layers")
    assert counts == image.counts()
    assert counts["num_layers"] == 3
    names = {f"{kind}-{layer}" for kind in ("colour", "votes") for layer in range(3)}
    expected = {f"{name}.png" for name in names} | {f"disparity-{layer}.pfm" for layer in range(3)}
    expected |= {"layers.json", "preview-layers.png", "preview-values.png", "index.html"}
    assert {path.name for path in Path("layers").iterdir()} == expected
    preview = cv2.imread("layers/preview-values.png", cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(preview, image.values_per_pixel * 85)
    assert run("layers", "surfaces", "--out", "again") == 0
    output = capsys.readouterr().out
    assert output.startswith("3 layers of 9 views: ")
    assert output.count("\n") == 1
    assert run("layers", "surfaces", "--out", "quiet", "--quiet") == 0
    assert capsys.readouterr().out == ""


def test_sprites_of_layers_and_of_surfaces(surfaces: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Sprites are the same from layers and from surfaces, hold all values, and give the view back."""
    assert run("layers", "surfaces", "--out", "layers", "--quiet") == 0
    assert run("sprites", "layers", "--out", "one", "--json", "-") == 0
    counts = json.loads(capsys.readouterr().out)
    assert run("sprites", "surfaces", "--out", "two", "--quiet", "--json", "counts.json") == 0
    assert json.loads(Path("counts.json").read_text()) == counts
    assert counts["gives_reference_back"] is True
    assert counts["num_values"] == counts["num_values_of_layers"] == sum(counts["num_values_by_sprite"])
    assert counts["num_sprites"] == len(read_sprites("one").sprites)
    for path in Path("one").iterdir():
        assert path.read_bytes() == (Path("two") / path.name).read_bytes()
    assert (Path("one") / "preview-sprites.png").exists()
    page = (Path("one") / "index.html").read_text(encoding="utf-8")
    assert page.count('aria-labelledby="group-') == min(counts["num_sprites"], 40)


@pytest.mark.parametrize("command", ["layers", "sprites"])
def test_meshes(surfaces: Path, command: str) -> None:
    """Meshes have a point for each value, coloured, and no triangle across discontinuities."""
    trimesh = pytest.importorskip("trimesh")
    assert run(command, "surfaces", "--out", "out", "--quiet", "--ply", "a.ply", "--glb", "a.glb") == 0
    num_values = layered_depth_image(reconstruction_of(SCENE, square_lattice(1), LABELS)).occupied.sum()
    mesh = trimesh.load("a.ply", process=False)
    assert len(mesh.vertices) == num_values
    z = mesh.vertices[mesh.faces][:, :, 2]
    assert np.ptp(z, axis=1).max() < 1e-6
    assert len(np.unique(np.round(z, 6))) == 3
    assert len(trimesh.load("a.glb", process=False).geometry) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("layers", "nothing", "--out", "out"), "nothing: not a folder of `dvc-stereo reconstruct`"),
        (("sprites", "nothing", "--out", "out"), "nothing: not a folder of `dvc-stereo layers`"),
        (("layers", "surfaces", "--out", "surfaces"), "not an empty folder"),
        (("layers", "surfaces"), "--out"),
        (("layers", "surfaces", "--out", "out", "--json", "surfaces/stereo.json"), "is also an input"),
        (("sprites", "surfaces", "--out", "out", "--json", "surfaces/stereo.json"), "is also an input"),
        (("sprites", "surfaces", "--out", "out", "--glb", "a.ply"), "ends in .glb"),
        (("layers", "surfaces", "--out", "out", "--json", "no/a.json"), "folder does not exist"),
    ],
)
def test_refusals(
    surfaces: Path, arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    check_refused(capsys, message, *arguments)
    assert not Path("out").exists()


def test_layers_without_values_have_no_sprites(surfaces: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = layered_depth_image(reconstruction_of(SCENE, square_lattice(1), LABELS))
    Path("empty").mkdir()
    write_layers(Path("empty"), replace(image, votes=np.zeros_like(image.votes)))
    check_refused(capsys, "empty: the layers have no values", "sprites", "empty", "--out", "out")
    assert not Path("out").exists()


def test_pictures_of_figures() -> None:
    image = layered_depth_image(reconstruction_of(SCENE, square_lattice(2), LABELS))
    table = draw_surfaces(image, 5.0, 7.0, np.s_[10:34, -20:70])
    assert table.shape == (24, 90, 3)
    drawn = (table != PAPER).any(axis=2)
    kept = (image.disparity == 6.0).any(axis=0)
    assert drawn.sum() == kept.sum() > (image.disparity[0] == 6.0).sum()
    assert set(np.unique(draw_values_per_pixel(image))) == {85, 170, 255}
    height, width = image.canvas.shape
    assert draw_layers(image).shape[1] > 3 * width
    assert draw_layers(image).shape[0] > 2 * height
