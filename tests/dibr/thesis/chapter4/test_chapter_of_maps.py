"""Chapter 4 measured again on a small map and its picture: files, numbers, figures, page in a browser."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from playwright.sync_api import Browser

from dvc.dibr.__main__ import main
from dvc.dibr.edges.extraction import edges_of_jumps
from dvc.dibr.thesis.chapter4.chapter import DOCUMENT, PAGE, VALUES
from dvc.dibr.thesis.chapter4.coefficients import high_bands
from dvc.dibr.thesis.chapter4.curves import PICTURE_RATES, map_point, picture_points
from dvc.dibr.thesis.chapter4.material import Material, load_material
from dvc.dibr.thesis.chapter4.pictures import EDGE_COLOUR, with_edges
from dvc.dibr.thesis.chapter4.signals import EDGES, NUM_LEVELS, largest_high, piecewise_signal, signal_bands
from dvc.dibr.wavelets.edge_maps import EdgeMaps
from dvc.pfm import write_pfm
from tests.dibr.commands.running import refusal
from tests.dibr.depth_maps import texture, two_discs
from tests.stereo.data import REAL_SETS, real_set

TIMEOUT_MS = 60_000
DISCS = two_discs()
RATES = 0.2, 0.3


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return what the command writes of a map and its picture."""
    scratch = tmp_path_factory.mktemp("chapter4")
    write_pfm(scratch / "discs.pfm", DISCS.astype(np.float32))
    cv2.imwrite(str(scratch / "picture.png"), texture())
    own = ["--map", str(scratch / "discs.pfm"), "--image", str(scratch / "picture.png")]
    out = scratch / "out"
    rates = ["--rates", *map(str, RATES)]
    assert main(["evaluate", "--chapter", "4", *own, *rates, "--out", str(out), "--quiet"]) == 0
    return out


def test_files_are_there(folder: Path) -> None:
    """Plots are PNG and SVG, pictures PNG; tables and numbers are beside them."""
    plots = {
        f"figure-{n}{suffix}" for n in ("4.3", "4.8a-discs", "4.8b-discs") for suffix in (".png", ".svg")
    }
    drawn = {f"figure-{n}-discs.png" for n in ("4.1", "4.6", "4.7")}
    assert {path.name for path in folder.iterdir()} == plots | drawn | {DOCUMENT, VALUES, PAGE}
    assert "## discs: depth map (figure 4.8a)" in (folder / DOCUMENT).read_text()


def test_numbers_are_those_of_files(folder: Path) -> None:
    """Rates are whole files; two sharp discs gain much; the picture never loses."""
    found = json.loads((folder / VALUES).read_text())
    discs = found["maps"]["discs"]
    for points in discs["map"].values():
        for point, rate in zip(points, RATES, strict=True):
            assert sum(point["bits"].values()) == 8 * point["bytes"] <= rate * DISCS.size
    standard, adaptive = (discs["map"][name] for name in ("standard", "shape-adaptive"))
    assert standard[0]["edge_elements"] == 0 < adaptive[0]["edge_elements"]
    gains = [ours["psnr_db"] - theirs["psnr_db"] for ours, theirs in zip(adaptive, standard, strict=True)]
    assert min(gains) > 5
    assert discs["largest_gain"]["db"] == pytest.approx(max(gains))
    assert [point["coefficients_bpp"] for point in discs["picture"]] == list(PICTURE_RATES)
    assert all(point["written_db"] >= point["standard_db"] for point in discs["picture"])
    entropies = {name: one["entropy_bpp"] for name, one in discs["coefficients"].items()}
    assert entropies["shape-adaptive"] < 0.7 * entropies["standard"]


def test_page_opens_without_an_error_or_a_request(browser: Browser, folder: Path) -> None:
    """Nothing is logged or loaded, all pictures are there, maps can be laid over each other."""
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
    assert page.locator("section[data-group] img").count() == 3 + 6
    assert page.locator("table").count() == 4
    assert page.locator("#left option").count() == 3
    page.close()


def test_all_but_the_coarsest_high_band_vanish() -> None:
    """Constant, linear and cubic pieces: zero by the shape-adaptive transform, not by the standard one."""
    signal, bands = piecewise_signal(), signal_bands()
    pieces = np.split(signal, np.array(EDGES) + 1)
    for piece, degree in zip(pieces, (0, 1, 3, 0), strict=True):
        assert np.abs(np.diff(piece, degree + 1)).max() < 1e-12
        assert degree == 0 or np.abs(np.diff(piece, degree)).max() > 1e-5
    adaptive, standard = largest_high(bands.shape_adaptive), largest_high(bands.standard)
    assert len(adaptive) == len(standard) == NUM_LEVELS
    assert max(adaptive[:-1]) < 1e-12
    assert min(standard) > 0.1


def test_entropy_is_that_of_symbols() -> None:
    """Edges at jumps take it away from a map that is constant in pieces."""
    steps = np.where(np.add.outer(np.arange(64), np.arange(64)) > 60, 40.0, 10.0)
    standard, found = high_bands(steps), high_bands(steps, edges_of_jumps(steps, 1.0))
    assert found.entropy_bpp < 0.1 * standard.entropy_bpp
    assert found.nonzero_share < 0.1 * standard.nonzero_share
    assert found.absolute.shape == steps.shape


def test_points_are_measured_as_files() -> None:
    """The PSNR of a point is that of its map, with the peak of the material."""
    material = Material("discs", DISCS, 50.0)
    point = map_point(material, 0.2)
    assert point.psnr_db == pytest.approx(10 * np.log10(50.0**2 / np.mean((point.depth - DISCS) ** 2)))
    assert point.edges_bpp == 8 * point.part_bytes["edges"] / DISCS.size > 0


def test_pictures_have_equal_bits() -> None:
    """What is written is the better one of both."""
    picture = np.where(two_discs() > 25, 200, 60).astype(np.uint8)
    (point,) = picture_points(picture, edges_of_jumps(DISCS, 5.0), [0.3])
    assert point.shape_adaptive_db > point.standard_db + 3
    assert point.chosen_db == point.shape_adaptive_db
    (useless,) = picture_points(texture(), edges_of_jumps(DISCS, 5.0), [0.3])
    assert useless.chosen_db == max(useless.standard_db, useless.shape_adaptive_db)


def test_edges_are_drawn_between_samples() -> None:
    """An edge to the right of a sample is at the right side of its square, one below at its bottom."""
    edges = EdgeMaps.none((3, 4))
    edges.between_columns[1, 2], edges.between_rows[0, 0] = 1, 1
    drawn = with_edges(np.zeros((3, 4), np.uint8), edges)
    red = np.argwhere((drawn == EDGE_COLOUR).all(axis=2)).tolist()
    assert red == [[1, 0], [1, 1], [2, 5], [3, 5]]


def test_teddy_is_as_in_the_thesis() -> None:
    """In pixels, holes filled, peak 53."""
    real_set("teddy")
    (teddy,) = load_material(REAL_SETS, None)
    assert teddy.depth.shape == (375, 450)
    assert (teddy.depth.min(), teddy.depth.max(), teddy.peak) == (12.5, 52.75, 53.0)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--chapter", "4", "--sets", "teddy", "--out", "o"], "--data must name a folder"),
        (["--chapter", "4", "--sets", "nothing", "--out", "o"], "expected one of"),
        (["--chapter", "4", "--rates", "0.1", "--out", "o"], "at least two"),
        (["--chapter", "4", "--lambdas", "1e-3", "--out", "o"], "--lambdas: not for chapter 4"),
        (["--chapter", "4", "view.png", "--out", "o"], "VIEW: not for chapter 4"),
        (["--chapter", "4", "--image", "a.png", "--out", "o"], "there is none"),
        (["--chapter", "4", "--map", "flat.png", "--data", ".", "--out", "o"], "not both"),
        (["--chapter", "4", "--map", "flat.png", "--out", "o"], "the map is constant"),
        (["--map", "flat.png", "--out", "o"], "--map: not for chapter 3"),
        (["--chapter", "4"], "--out is needed"),
        (["--truth-depth", "flat.png", "--out", "o"], "not for a chapter"),
    ],
)
def test_mistakes_are_told_in_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    told: str,
) -> None:
    """Each ends with status 2 and one line, and leaves no folder."""
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("flat.png", np.full((32, 32), 9, np.uint8))
    assert told in refusal(capsys, "evaluate", *arguments)
