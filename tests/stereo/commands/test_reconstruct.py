"""`dvc-stereo reconstruct`: folder, figures, warnings and refusals."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from dvc.errors import ConfigError, DvcError
from dvc.geometry.camera_array import DisparityLabels
from dvc.picture_files import read_pfm, read_picture
from dvc.stereo.surfaces.reconstruct import most_steps, reconstruct
from dvc.stereo.surfaces.stereo_settings import StereoSettings
from dvc.stereo.surfaces.surface_folder import read_reconstruction
from tests.stereo.data import array_of, check_refused, pair_of_planes, run

PAIR = "left.png right.png --disparities 0:8"


@pytest.fixture
def views(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a pair and its truth into a folder, and work there."""
    left, right, disparity = pair_of_planes()
    cv2.imwrite(str(tmp_path / "left.png"), left[:, :, ::-1])
    cv2.imwrite(str(tmp_path / "right.png"), right[:, :, ::-1])
    cv2.imwrite(str(tmp_path / "truth.png"), (disparity * 16).astype(np.uint8))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_data_pictures_and_page_are_written(views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = ["--truth", "truth.png", "--truth-scale", "16"]
    assert run("reconstruct", *PAIR.split(), "--out", "out", *truth) == 0
    kinds = {"view", "preview", "occluded", "confidence"}
    expected = {f"{kind}-{name}.png" for kind in kinds for name in ("left", "right")}
    expected |= {"disparity-left.pfm", "disparity-right.pfm", "error-left.png", "index.html", "stereo.json"}
    assert {path.name for path in (views / "out").iterdir()} == expected
    index = json.loads((views / "out" / "stereo.json").read_text())
    assert index["evaluation"]["bad_percent"]["1"] < 15.0
    assert [one["name"] for one in index["surfaces"]] == ["left", "right"]
    assert "bad pixels of left" in capsys.readouterr().out
    found = read_reconstruction(views / "out")
    np.testing.assert_array_equal(found.surfaces[0].disparity, read_pfm(views / "out" / "disparity-left.pfm"))
    picture = read_picture("out/preview-left.png").astype(int)
    assert picture[24, 30].sum() > picture[4, 30].sum(), "near must be brighter"
    page = (views / "out" / "index.html").read_text(encoding="utf-8")
    assert page.count("<figure><img data-name=") == 9


def test_json_and_meshes(views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("trimesh")
    shapes = ["--ply", "a.ply", "--glb", "a.glb"]
    assert run("reconstruct", *PAIR.split(), "--out", "out", "--json", "-", *shapes) == 0
    assert json.loads(capsys.readouterr().out)["surfaces"][0]["highest_px"] <= 8.0
    assert (views / "a.ply").read_bytes().startswith(b"ply")
    assert (views / "a.glb").read_bytes().startswith(b"glTF")
    assert run("reconstruct", *PAIR.split(), "--out", "two", "--quiet") == 0
    assert capsys.readouterr().out == ""


def test_a_mesh_may_be_in_the_folder(views: Path) -> None:
    pytest.importorskip("trimesh")
    (views / "out").mkdir()
    assert run("reconstruct", *PAIR.split(), "--out", "out", "--ply", "out/a.ply") == 0
    assert {"a.ply", "stereo.json"} <= {path.name for path in (views / "out").iterdir()}


def test_grey_and_deep_pictures_are_taken(views: Path) -> None:
    left, right = (read_picture(f"{name}.png")[:, :, 1] for name in ("left", "right"))
    cv2.imwrite("left16.png", left.astype(np.uint16) * 257)
    cv2.imwrite("right8.png", right)
    truth = ["--truth", "truth.png", "--truth-scale", "16", "--json", "figures.json"]
    assert run("reconstruct", "left16.png", "right8.png", "--disparities", "0:8", "--out", "out", *truth) == 0
    assert json.loads((views / "figures.json").read_text())["evaluation"]["bad_percent"]["1"] < 20.0


def test_range_that_is_too_narrow_is_reported(views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("reconstruct", "left.png", "right.png", "--disparities=-2:2", "--out", "out") == 0
    assert "highest disparity, 2 px" in capsys.readouterr().err
    assert len(json.loads((views / "out" / "stereo.json").read_text())["warnings"]) == 1


def test_identical_views_have_no_disparity(views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (views / "same.png").write_bytes((views / "left.png").read_bytes())
    assert run("reconstruct", "left.png", "same.png", "--disparities=-3:3", "--out", "out") == 0
    assert "identical" in capsys.readouterr().err
    assert np.abs(read_pfm(views / "out" / "disparity-left.pfm")).max() < 0.5
    assert run("reconstruct", "left.png", "same.png", "--disparities", "0:3", "--out", "from0") == 0
    assert len(capsys.readouterr().err.splitlines()) == 1, "0 is right, though the end of the range"
    options = "left.png", "same.png", "--disparities", "1:3", "--out", "none"
    check_refused(capsys, "no disparity but 0 fits", "reconstruct", *options)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("left.png --disparities 0:8", "at least two views"),
        ("left.png none.png --disparities 0:8", "none.png: No such file"),
        ("left.png small.png --disparities 0:8", "all must have one size"),
        ("left.png black.png --disparities 0:8", "a single colour"),
        ("left.png text.png --disparities 0:8", "not a picture"),
        ("left.png \udcff.png --disparities 0:8", "not of Unicode characters"),
        ("left.png right.png", "--disparities"),
        ("left.png right.png --disparities 8:0", "MIN <= MAX"),
        ("left.png right.png --disparities 0:1e9:1e6", "none beyond 1e+06"),
        ("left.png right.png --disparities 0:0:1e-300", "expected a step of"),
        (f"{PAIR} --lattice 0,0 1e300,0", "expected M,N"),
        (f"{PAIR} --lattice 0,0 -0,0", "the position 0,0"),
        (f"{PAIR} --mask truth.png", "require --truth"),
        (f"{PAIR} --ply a.obj", "ends in .ply"),
        (f"{PAIR} --json left.png", "is also an input"),
        ("left.png right.png --views text.png --json text.png", "is also an input"),
        ("left.png right.png --cameras colmap --json colmap/cameras.txt", "also an input"),
        (f"{PAIR} --truth truth.png", "--truth-scale"),
        (f"{PAIR} --truth small.png --truth-scale 4", "small.png: 10x10, but the views are 72x48"),
        (f"{PAIR} --truth black.png --truth-scale 4", "no pixel counts"),
    ],
)
def test_bad_input_is_one_line(
    views: Path, capsys: pytest.CaptureFixture[str], arguments: str, message: str
) -> None:
    cv2.imwrite("small.png", np.eye(10, dtype=np.uint8) * 200)
    cv2.imwrite("black.png", np.zeros((48, 72, 3), np.uint8))
    (views / "text.png").write_text("no picture")
    (views / "colmap").mkdir()
    (views / "colmap" / "cameras.txt").touch()
    check_refused(capsys, message, "reconstruct", *arguments.split(), "--out", "out")
    assert not (views / "out").exists()


def test_views_in_the_wrong_order_are_refused(
    views: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = cv2.GaussianBlur(rng.integers(0, 256, (80, 160, 3), dtype=np.uint8), (0, 0), 1.2)
    scene = np.clip(3.0 * (scene - 127.5) + 127.5, 0, 255).astype(np.uint8)
    for name, left in (("a", 0), ("b", 4)):
        cv2.imwrite(f"{name}.png", scene[:, left : left + 150])
    for options, message in (
        ("b.png a.png --disparities 0:8", "have disparities from -4"),
        ("a.png b.png --disparities 20:30", "not 20 to 30"),
    ):
        check_refused(capsys, message, "reconstruct", *options.split(), "--out", "out")
    assert not (views / "out").exists()
    turned = "b.png a.png --lattice 1,0 0,0 --disparities 0:8 --out out"
    assert run("reconstruct", *turned.split()) == 0


def test_work_space_is_bounded() -> None:
    views = array_of(*np.zeros((2, 400, 2700, 3), np.uint8))
    with pytest.raises(ConfigError, match="4001 disparities in steps"):
        reconstruct(views, DisparityLabels(0.0, 0.01, 4001))


@pytest.mark.parametrize(("step", "large_cells"), [(1.0, 1 << 30), (1.0, 10_000), (0.25, 10_000)])
def test_progress_has_an_end(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, step: float, large_cells: int
) -> None:
    monkeypatch.setattr("dvc.stereo.surfaces.reconstruct.LARGE_CELLS", large_cells)
    scene = rng.integers(0, 256, (60, 110, 3), dtype=np.uint8)
    array, labels = array_of(scene[:, :100], scene[:, 4:104]), DisparityLabels(0.0, step, 16)
    settings = StereoSettings(min_change=-1.0, inference="semi-global", cost="squared")
    done: list[int] = []
    reconstruct(array, labels, settings, advance=done.append)
    assert sum(done) == most_steps(array, labels, settings)


@pytest.mark.parametrize(
    ("part", "values", "message"),
    [
        ("disparities", {"num_labels": 3.5}, "'num_labels' must be a whole number"),
        ("disparities", {"step": 1e-300}, "'step' is out of range"),
        ("disparities", {"lowest": 1e300}, "'lowest' is out of range"),
        ("view", {"m": 1e300}, "'m' is out of range"),
        ("view", {"m": 1.0}, "two views have one position"),
    ],
)
def test_impossible_numbers_of_an_index_are_refused(
    views: Path, part: str, values: dict[str, float], message: str
) -> None:
    assert run("reconstruct", *PAIR.split(), "--out", "out", "--quiet") == 0
    path = views / "out" / "stereo.json"
    index = json.loads(path.read_text())
    (index["views"][0] if part == "view" else index["disparities"]).update(values)
    path.write_text(json.dumps(index))
    with pytest.raises(DvcError, match=message):
        read_reconstruction(views / "out")
