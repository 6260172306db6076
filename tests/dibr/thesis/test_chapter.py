"""Chapter 3 measured again on small views: files, numbers, tables, and the page in a browser."""

import json
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from dvc.dibr.__main__ import main
from dvc.dibr.codec.encoder import ViewEncoder
from dvc.dibr.disparity.integer_transforms import level_shapes
from dvc.dibr.stream.header import DisparityMethod
from dvc.dibr.thesis.chapter import DOCUMENT, EARLY_LEVELS, NUM_LAYERS, PAGE, VALUES
from dvc.dibr.thesis.curves import measure, reference_multipliers
from dvc.dibr.thesis.decomposition import stopped_early
from dvc.dibr.thesis.scenes import everywhere_valid, load_scenes, scene_of_views
from dvc.errors import ConfigError
from dvc.multiview.camera_array import ArrayView, CameraArray, LatticePosition
from dvc.picture_files import write_png
from tests.dibr.plane_views import LABELS, planes
from tests.stereo.data import REAL_SETS, real_set

TIMEOUT_MS = 60_000
MULTIPLIERS = "1e-2", "2e-3", "4e-4"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return what the command writes of two small views."""
    scratch = tmp_path_factory.mktemp("evaluate")
    for view in planes(96, 128):
        write_png(scratch / f"{view.name}.png", np.ascontiguousarray(view.image[:, :, ::-1]))
    arguments = [str(scratch / "left.png"), str(scratch / "right.png"), "--disparities", "0:9"]
    out = scratch / "out"
    assert main(["evaluate", *arguments, "--lambdas", *MULTIPLIERS, "--out", str(out), "--quiet"]) == 0
    return out


def test_files_are_there(folder: Path) -> None:
    """Plots are PNG and SVG, pictures PNG; tables and numbers are beside them."""
    names = {path.name for path in folder.iterdir()}
    plots = {f"figure-{n}-views{suffix}" for n in ("3.13", "3.14", "3.15") for suffix in (".png", ".svg")}
    drawn = {f"figure-{n}-views.png" for n in ("3.9", "3.10", "3.12", "decomposition")}
    assert names == plots | drawn | {DOCUMENT, VALUES, PAGE}
    assert "## views: other codecs" in (folder / DOCUMENT).read_text()


def test_numbers_are_those_of_files(folder: Path) -> None:
    """Rates are whole files; parts are less; smaller multipliers cost more and look better."""
    found = json.loads((folder / VALUES).read_text())["views"]
    assert set(found["curves"]) == {method.name.lower() for method in DisparityMethod}
    for points in found["curves"].values():
        assert [point["lambda"] for point in points] == [1e-2, 2e-3, 4e-4]
        sizes = [point["bytes"] for point in points]
        assert sizes == sorted(sizes)
        assert points[2]["psnr_pooled_db"] > points[0]["psnr_pooled_db"] + 1.0
        for point in points:
            assert point["picture_bytes"] + point["disparity_bytes"] < point["bytes"]
            assert point["rate_bpp"] == pytest.approx(8 * point["bytes"] / (96 * 128))
    for points in found["layered"].values():
        assert len(points) == NUM_LAYERS
        assert [point["bytes"] for point in points] == sorted(point["bytes"] for point in points)
    assert set(found["decomposition"]) == set(EARLY_LEVELS)
    for peer in found["peers"].values():
        known = [(one["bytes"], own["bytes"]) for one, own in zip(peer, found["pair"], strict=True) if one]
        assert all(theirs <= ours for theirs, ours in known)


def test_page_opens_without_an_error_or_a_request(browser: Browser, folder: Path) -> None:
    """Nothing is logged or loaded, all pictures are there, methods can be laid over each other."""
    page = browser.new_page()
    logged: list[str] = []
    requests: list[str] = []
    page.on("console", lambda message: logged.append(message.text))
    page.on("pageerror", lambda error: logged.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    address = (folder / PAGE).as_uri()
    page.goto(address, timeout=TIMEOUT_MS)
    assert logged == []
    assert [url for url in requests if not url.startswith("data:")] == [address]
    assert page.evaluate("[...document.images].every((image) => image.complete && image.naturalWidth > 0)")
    assert page.locator("section[data-group] img").count() == 5 + 7
    assert page.locator("table").count() == 6
    assert page.locator("#left option").count() == 5
    page.close()


def test_stopping_early_stores_more_roots() -> None:
    """Where the tree ends earlier it has more roots; down to one pixel it is what the command writes."""
    scene = scene_of_views(planes(64, 80), LABELS)
    full = stopped_early(scene.views, LABELS, 2e-3, None)
    assert full.num_bytes == measure(scene.views, ViewEncoder(scene.views, LABELS).encode(2e-3)).num_bytes
    early = stopped_early(scene.views, LABELS, 2e-3, 2)
    assert early.disparity_bytes > full.disparity_bytes
    assert level_shapes((64, 80), 2)[-1] == (16, 20)


def test_multipliers_give_the_rates_of_the_reference() -> None:
    """At the multiplier for a rate the picture takes about that."""
    views = scene_of_views(planes(96, 128), LABELS).views
    (multiplier,) = reference_multipliers(views, [0.5])
    encoded = ViewEncoder(views, LABELS).encode(multiplier)
    assert 0.35 <= 8 * encoded.picture_bytes / (96 * 128) <= 0.7


def test_views_are_cropped_to_what_all_see() -> None:
    """The common frame has no pixel that a camera has not seen, and is not smaller than it must be."""
    image = np.arange(20 * 30 * 3, dtype=np.uint64).astype(np.uint8).reshape(20, 30, 3)
    valid = np.ones((20, 30), np.bool_)
    valid[:3], valid[:, -2:] = False, False
    views = ArrayView("a", image, LatticePosition(0, 0), valid), ArrayView("b", image, LatticePosition(1, 0))
    found = everywhere_valid(CameraArray(views))
    assert found.shape == (17, 28)
    np.testing.assert_array_equal(found[1].image, image[3:, :-2])


def test_real_sets_are_as_in_the_thesis() -> None:
    """Tsukuba has nine views without its border, the reference first; Teddy two."""
    real_set("tsukuba")
    tsukuba, teddy = load_scenes(REAL_SETS, ["tsukuba", "teddy"])
    assert tsukuba.array.shape == (284, 380)
    assert len(tsukuba.array) == 9
    assert tsukuba.array[0].name == "scene1.row3.col3"
    assert [view.name for view in tsukuba.pair] == ["scene1.row3.col3", "scene1.row3.col4"]
    assert len(teddy.array) == 2
    (cones,) = load_scenes(REAL_SETS, ["cones"])
    assert [view.name for view in cones.pair] == ["im2", "im6"]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--sets", "teddy"], "--data must name a folder"),
        (["--sets", "nothing"], "expected one of"),
        (["--lambdas", "1e-3"], "at least two"),
        (["--disparities", "0:9"], "is for own views"),
        (["a.png", "b.png"], "--disparities MIN:MAX is needed"),
        (["a.png", "b.png", "--data", "."], "not both"),
    ],
)
def test_mistakes_are_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], told: str
) -> None:
    """Each ends with status 2 and one line, and leaves no folder."""
    assert main(["evaluate", *arguments, "--out", str(tmp_path / "out")]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert told in captured.err
    assert not (tmp_path / "out").exists()
    with pytest.raises(ConfigError):
        load_scenes(None, ["teddy"])
