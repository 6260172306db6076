"""`dvc-stereo rectify`, and `reconstruct --cameras`: files, contracts, and one line for bad input."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from dvc.picture_files import read_pfm, read_picture, write_png
from dvc.stereo.surfaces.surface_folder import read_reconstruction
from sequences.rendered_sequence import write_array
from tests.stereo.data import check_refused, run

NAMES = ("toy-0-0", "toy-1-0")
SIZE = 128, 96


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Render the toy array small."""
    folder = tmp_path_factory.mktemp("array") / "toy"
    write_array("toy", folder, *SIZE)
    return folder


@pytest.fixture
def toy(rendered: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in the folder of the pictures."""
    monkeypatch.chdir(rendered)
    return rendered


def test_rectify_writes_views_masks_and_homographies(
    toy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    paths = sorted(toy.glob("toy-*.png"))
    assert run("rectify", *paths, "--cameras", "cameras.json", "--out", out) == 0
    output = capsys.readouterr().out
    assert "4 views" in output
    assert "px rms" in output
    index = json.loads((out / "rectification.json").read_text())
    size = index["height"], index["width"]
    with open(out / "views.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(float(row["m"]), float(row["n"])) for row in rows] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    for row, path, view in zip(rows, paths, index["views"], strict=True):
        assert row["file"] == f"view-{path.name}"
        picture, valid = read_picture(out / row["file"]), read_picture(out / f"valid-{path.name}")[:, :, 0]
        assert picture.shape[:2] == valid.shape == size
        assert set(np.unique(valid)) <= {0, 255}
        assert not picture[valid == 0].any()
        warped = cv2.warpPerspective(
            read_picture(path), np.array(view["rectified_from_view"]), size[::-1], flags=cv2.INTER_LANCZOS4
        )
        inner = cv2.erode(np.pad(valid, 1), np.ones((13, 13), np.uint8))[1:-1, 1:-1] > 0
        assert np.abs(warped[inner].astype(int) - picture[inner]).mean() < 1.0
    space = np.array(index["rectified_from_world"])
    assert space.shape == (4, 4)
    assert read_picture(out / "preview.png").shape[1] <= 1600
    views = sorted(out.glob("view-*.png"))
    again = tmp_path / "again"
    assert (
        run("reconstruct", *views, "--views", out / "views.csv", "--disparities", "0:2", "--out", again) == 0
    )


def test_reconstruct_gives_both_frames_and_metric_depth(toy: Path, tmp_path: Path) -> None:
    """Disparity in the rectified and the original frame, depth near the truth, homographies in the index."""
    out = tmp_path / "out"
    paths = sorted(toy.glob("toy-*.png"))
    assert run("reconstruct", *paths, "--cameras", "cameras.json", "--out", out, "--quiet") == 0
    index = json.loads((out / "stereo.json").read_text())
    found = read_reconstruction(out)
    assert found.array[0].valid is not None
    assert not found.array[0].valid.all()
    for path, view in zip(paths, index["rectification"]["views"], strict=True):
        name = path.stem
        assert read_pfm(out / f"disparity-{name}.pfm").shape == (index["height"], index["width"])
        original = read_pfm(out / f"original-disparity-{name}.pfm")
        depth, true = read_pfm(out / f"depth-{name}.pfm"), read_pfm(toy / f"depth-{name}.pfm")
        assert original.shape == depth.shape == SIZE[::-1]
        assert np.isfinite(original).all()
        assert np.median(np.abs(depth / true - 1.0)) < 0.08
        assert read_picture(out / f"original-occluded-{name}.png").shape[:2] == SIZE[::-1]
        assert view["file"] == path.name


def test_folder_of_rectified_views_is_as_good_as_the_cameras(
    toy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`rectify`, then `reconstruct` of its folder: the files of `reconstruct --cameras`."""
    pair, cameras = (toy / "toy-0-0.png", toy / "toy-1-0.png"), ("--cameras", "cameras.json")
    out = [tmp_path / name for name in ("rectified", "two", "one")]
    assert run("rectify", *pair, *cameras, "--out", out[0], "--quiet") == 0
    assert run("reconstruct", out[0], "--out", out[1], "--quiet") == 0
    assert run("reconstruct", *pair, *cameras, "--out", out[2], "--quiet") == 0
    assert {path.name for path in out[1].iterdir()} == {path.name for path in out[2].iterdir()}
    for name in ("depth-toy-0-0.pfm", "original-disparity-toy-1-0.pfm", "valid-toy-0-0.png"):
        assert (out[1] / name).read_bytes() == (out[2] / name).read_bytes()
    none = "--out", tmp_path / "none"
    index = out[0] / "rectification.json"
    whole = json.loads(index.read_text())
    for changed, message in (
        ({"lattice": {}}, "no 'origin'"),
        ({"views": whole["views"][:1]}, "fewer than two views"),
        ({"width": 7}, "not an eight-bit grey picture of 7x"),
        ({"offset_px": [1.0]}, "'offset_px' must be a list of 2 numbers"),
        ({"lattice": {**whole["lattice"], "v1": [0.0, 0.0, 0.0]}}, "span no plane"),
        ({"lattice": {**whole["lattice"], "v1": whole["lattice"]["v2"]}}, "span no plane"),
        ({"row_rms_px": float("nan")}, "not a JSON file"),
    ):
        index.write_text(json.dumps({**whole, **changed}))
        check_refused(capsys, message, "reconstruct", out[0], *none)
    index.write_text(json.dumps({**whole, "row_rms_px": 9.0}).replace("9.0", "1e999"))
    check_refused(capsys, "not a JSON file", "reconstruct", out[0], *none)
    index.write_text(json.dumps(whole))
    valid = read_picture(out[0] / "valid-toy-0-0.png")[:, :, 0]
    write_png(out[0] / "valid-toy-0-0.png", np.zeros_like(valid))
    check_refused(capsys, "has no valid pixel", "reconstruct", out[0], *none)
    index.unlink()
    check_refused(capsys, "not a folder of `dvc-stereo rectify`", "reconstruct", out[0], *none)
    check_refused(capsys, "excludes other views", "reconstruct", out[0], pair[0], *none)
    check_refused(capsys, "excludes --cameras", "reconstruct", out[0], *cameras, *none)


def test_rectified_input_keeps_its_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.integers(0, 256, (48, 90, 3)).astype(np.uint8), (0, 0), 1.0)
    cameras = []
    for m in (0, 1):
        cv2.imwrite(str(tmp_path / f"{m}.png"), texture[:, 6 * m : 72 + 6 * m])
        K = [[60, 0, 30 + m], [0, 60, 24], [0, 0, 1]]
        cameras.append({"file": f"{m}.png", "K": K, "R": np.eye(3).tolist(), "t": [-0.5 * m, 0, 0]})
    (tmp_path / "cameras.json").write_text(json.dumps(cameras))
    monkeypatch.chdir(tmp_path)
    options = ["--cameras", "cameras.json", "--disparities", "0:9", "--out", "out"]
    assert run("reconstruct", "0.png", "1.png", *options) == 0
    assert read_picture("out/view-0.png").tobytes() == read_picture("0.png").tobytes()
    assert not list(tmp_path.glob("out/original-*"))
    assert not list(tmp_path.glob("out/valid-*"))
    disparity, depth = read_pfm("out/disparity-0.pfm"), read_pfm("out/depth-0.pfm")
    assert np.median(disparity) == pytest.approx(6.0, abs=0.5)
    np.testing.assert_allclose(depth, 60 * 0.5 / (disparity + 1), rtol=1e-4)


def test_range_of_rectified_views_comes_from_their_matches(toy: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    wide = cv2.GaussianBlur(rng.integers(0, 256, (96, 200, 3)).astype(np.uint8), (0, 0), 1.2)
    for k, name in enumerate(("left", "right")):
        cv2.imwrite(str(tmp_path / f"{name}.png"), wide[:, 5 * k : 180 + 5 * k])
    pair = tmp_path / "left.png", tmp_path / "right.png"
    assert run("reconstruct", *pair, "--out", tmp_path / "out", "--quiet") == 0
    labels = read_reconstruction(tmp_path / "out").labels
    assert labels.lowest <= 4.0
    assert 6.0 <= labels.highest < 12.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["toy-0-0.png"], "at least two views"),
        (["toy-0-0.png", "toy-0-0.png"], "two views have the name toy-0-0"),
        (["toy-0-0.png", "missing.png"], "missing.png: No such file"),
        (["toy-0-0.png", "toy-1-0.png", "--lattice", "0,0"], "2 views and 1 positions"),
        (["toy-0-0.png", "toy-1-0.png", "--views", "no.csv"], "no.csv: No such file"),
        (["toy-0-0.png", "depth-toy-0-0.pfm"], "not a picture"),
        (["toy-0-0.png", "toy-1-0.png", "--lattice", "0,0", "1,0", "--views", "views.csv"], "not allowed"),
        (["toy-0-0.png", "toy-1-0.png", "--lattice", "0,0", "0,0"], "have one position"),
    ],
)
def test_bad_input_is_one_line(
    toy: Path, tmp_path: Path, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = "--cameras", "cameras.json", "--out", tmp_path / "out"
    check_refused(capsys, message, "rectify", *arguments, *options)
    assert not list(tmp_path.iterdir())


def test_missing_cameras_are_one_line(toy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("blank-a.png", "blank-b.png"):
        cv2.imwrite(str(tmp_path / name), np.full((32, 32, 3), 90, np.uint8))
    pair = tmp_path / "blank-a.png", tmp_path / "blank-b.png"
    out = "--out", tmp_path / "out"
    check_refused(capsys, "no.json: No such file", "rectify", *pair, "--cameras", "no.json", *out)
    check_refused(capsys, "cannot be estimated", "rectify", *pair, "--cameras", "auto", *out)
    check_refused(capsys, "give --disparities", "reconstruct", *pair, *out)
