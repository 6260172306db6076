"""The page of the viewer in a browser: what it draws, how it is moved by hand, what it misses."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

from dvc.dibr.__main__ import main
from dvc.dibr.depth_image.scene_pieces import Bounds
from dvc.dibr.view_rendering import picture_of, render
from dvc.dibr.view_stream import Decoded, decode, decode_stream
from dvc.dibr.viewer_page import Caption, Scene, scene_of_pieces, source_of, write_page
from dvc.geometry.camera_array import LatticePosition
from dvc.geometry.viewpoints import CalibratedViewpoint, Viewpoint
from dvc.metrics import psnr_db
from tests.browser import wait_until
from tests.dibr.piece_scenes import plane_layers, plane_sprites
from tests.drawn_pages import (
    TIMEOUT_MS,
    TOLD,
    Opened,
    lose_context,
    opened_pages,
    restore_context,
    saved_picture,
)
from tests.stereo.plane_scenes import LABELS, SCENE, reconstruction_of, square_lattice

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "dibr"
READY = "document.documentElement.classList.contains('ready')"
INTRINSIC = np.array([[60.0, 0.0, 30.0], [0.0, 60.0, 20.0], [0.0, 0.0, 1.0]])
APART = np.column_stack([np.eye(3), [-1.0, 0.0, 0.0]])
NO_WEBGL = "HTMLCanvasElement.prototype.getContext = () => null;"


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a page of each kind of scene, and return their folder."""
    folder = tmp_path_factory.mktemp("pages")
    for name in ("colour", "two-references", "calibrated"):
        path = str(folder / f"{name}.html")
        assert main(["view", str(GOLDEN / f"{name}.dibr"), "--out", path, "--quiet"]) == 0
    cameras = [CalibratedViewpoint(INTRINSIC, pose) for pose in (np.eye(3, 4), APART)]
    for name, scene in (
        ("layers", scene_of_pieces(plane_layers())),
        ("sprites", scene_of_pieces(plane_sprites())),
        ("flat", flat_scene(LatticePosition(0.0, 0.0))),
        ("cameras", flat_scene(*cameras)),
    ):
        write_page(folder / f"{name}.html", scene, Caption(name, name, 1000, 2400))
    return folder


def flat_scene(*viewpoints: Viewpoint) -> Scene:
    """Return a plane before the first of some viewpoints."""
    rng = np.random.default_rng(2)
    picture = np.kron(rng.integers(0, 256, (8, 12, 3)), np.ones((5, 5, 1))).astype(np.uint8)
    disparity = np.full((40, 60), 0.2 if isinstance(viewpoints[0], CalibratedViewpoint) else 10.0)
    source = source_of(picture, disparity, None, viewpoints[0])
    return Scene((40, 60), (source,), 0.1, viewpoints, Bounds(-1.0, 1.0, -1.0, 1.0))


@pytest.fixture
def opened(graphics_browser: Browser, pages: Path) -> Iterator[Opened]:
    """Return what opens a page."""
    with opened_pages(graphics_browser, pages, READY, (640, 720)) as opening:
        yield opening


def go(page: Page, m: float, n: float) -> None:
    for name, value in (("m", m), ("n", n)):
        page.fill(f"#at-{name}", repr(value))
        page.press(f"#at-{name}", "Enter")


def place(page: Page) -> tuple[float, float, float]:
    m, n, closer = (float(page.input_value(f"#at-{name}")) for name in ("m", "n", "closer"))
    return m, n, closer


def decoded(name: str) -> Decoded:
    return decode(decode_stream((GOLDEN / f"{name}.dibr").read_bytes()))


def agreement_db(page: Page, stream: Decoded, viewpoint: Viewpoint) -> tuple[float, ...]:
    """Return PSNR of the page's picture against the renderer's: where something was seen, and everywhere."""
    view = render(stream, viewpoint)
    wanted, found = picture_of(view), saved_picture(page)
    wanted = np.broadcast_to(wanted.reshape(*wanted.shape[:2], -1), found.shape)
    everywhere = np.ones_like(view.drawn)
    return tuple(psnr_db(found[where], wanted[where]) for where in (view.drawn, everywhere))


@pytest.mark.parametrize("name", ["colour", "two-references"])
def test_streams_look_as_they_are_rendered(opened: Opened, name: str) -> None:
    page, stream = opened(name), decoded(name)
    first = picture_of(render(stream, stream.pairs[0].viewpoint))
    np.testing.assert_array_equal(saved_picture(page, by_pointer=True), first)
    for place in ((0.5, 0.0), (1.0, 0.0), (0.3, 0.1)):
        go(page, *place)
        seen_db, all_db = agreement_db(page, stream, LatticePosition(*place))
        assert seen_db > 35.0
        assert all_db > 25.0


def test_calibrated_cameras_look_as_they_are_rendered(opened: Opened) -> None:
    page, stream = opened("calibrated"), decoded("calibrated")
    views = page.evaluate("JSON.parse(document.getElementById('scene').textContent).views")
    assert len(views) == len(stream.header.viewpoints)
    for view, viewpoint in zip(views, stream.header.viewpoints, strict=True):
        go(page, view["m"], view["n"])
        assert agreement_db(page, stream, viewpoint)[0] > 35.0


@pytest.mark.parametrize("name", ["layers", "sprites"])
def test_layers_and_sprites_show_what_cameras_saw(opened: Opened, name: str) -> None:
    page = opened(name)
    views = {view.position: view.image for view in reconstruction_of(SCENE, square_lattice(1), LABELS).array}
    np.testing.assert_array_equal(saved_picture(page), views[LatticePosition(0.0, 0.0)])
    for place in ((1.0, 0.0), (-1.0, 1.0)):
        go(page, *place)
        found = saved_picture(page)
        assert (np.abs(found.astype(int) - views[LatticePosition(*place)]).max(axis=2) <= 2).mean() > 0.97


def test_viewpoint_is_moved_by_pointer_keys_wheel_and_touch(opened: Opened) -> None:
    page = opened("colour", has_touch=True)
    first = saved_picture(page)
    canvas = page.locator("#view")
    box = canvas.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 60, y - 40, steps=3)
    page.mouse.up()
    m, n, closer = place(page)
    assert m > 0.0
    assert n > 0.0
    assert closer == 0.0
    assert not np.array_equal(saved_picture(page), first)
    page.mouse.move(x, y)
    page.mouse.wheel(0, -300)
    wait_until(page, "Number(document.getElementById('at-closer').value) > 0")
    canvas.focus()
    page.keyboard.press("ArrowRight")
    assert place(page)[0] > m
    for _ in range(60):
        page.keyboard.press("Shift+ArrowRight")
    bounds = page.evaluate("JSON.parse(document.getElementById('scene').textContent).bounds")
    assert place(page)[0] == pytest.approx(bounds["right"])
    page.keyboard.press("-")
    page.keyboard.press("Home")
    assert place(page) == (0.0, 0.0, 0.0)
    np.testing.assert_array_equal(saved_picture(page), first)
    page.touchscreen.tap(x, y)
    assert place(page) == (0.0, 0.0, 0.0)


def test_two_fingers_come_closer(opened: Opened) -> None:
    page = opened("colour", has_touch=True, is_mobile=True, viewport={"width": 360, "height": 740})
    session = page.context.new_cdp_session(page)
    box = page.locator("#view").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def touch(kind: str, *points: tuple[float, float]) -> None:
        places = [{"x": a, "y": b, "id": number} for number, (a, b) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})

    touch("touchStart", (x - 20, y), (x + 20, y))
    touch("touchMove", (x - 60, y), (x + 60, y))
    touch("touchEnd")
    wait_until(page, "Number(document.getElementById('at-closer').value) > 0.2")
    touch("touchStart", (x, y))
    touch("touchMove", (x - 80, y))
    touch("touchEnd")
    wait_until(page, "Number(document.getElementById('at-m').value) > 0.1")
    assert page.evaluate("document.documentElement.scrollWidth") <= 360


def test_holes_are_marked_or_filled(opened: Opened) -> None:
    page, stream = opened("colour"), decoded("colour")
    go(page, 1.0, 0.0)
    drawn = render(stream, LatticePosition(1.0, 0.0)).drawn
    filled = saved_picture(page).astype(int)
    page.check("#mark")
    marked = np.abs(saved_picture(page).astype(int) - filled).max(axis=2) > 0
    assert marked[~drawn].mean() > 0.9
    assert marked[drawn].mean() < 0.02


def test_depth_and_grid_are_shown(opened: Opened) -> None:
    page, stream = opened("colour"), decoded("colour")
    picture = saved_picture(page).astype(float)
    page.check("#depth")
    brightness = saved_picture(page).astype(float).sum(axis=2)
    disparity = stream.pairs[0].disparity
    assert np.corrcoef(brightness.ravel(), disparity.ravel())[0, 1] > 0.8
    page.check("#lines")
    assert saved_picture(page)[4::8, 4::8].mean() < 0.5 * picture.mean()
    page.locator("#view").focus()
    page.keyboard.press("v")
    assert page.locator("#picture").is_checked()


@pytest.mark.parametrize("name", ["flat", "cameras"])
def test_middle_is_held_in_place(opened: Opened, name: str) -> None:
    page = opened(name)
    before = saved_picture(page).astype(int)
    go(page, 0.5, 0.2)
    assert np.abs(saved_picture(page) - before)[8:-8, 8:-8].mean() > 10.0
    page.locator("#view").focus()
    page.keyboard.press("h")
    assert np.abs(saved_picture(page) - before)[8:-8, 8:-8].max() <= 2


def test_context_that_is_lost_comes_back(opened: Opened) -> None:
    page = opened("colour")
    before = saved_picture(page)
    lose_context(page)
    assert not page.evaluate(READY)
    assert page.locator("#still").is_visible()
    restore_context(page, READY)
    np.testing.assert_array_equal(saved_picture(page), before)


@pytest.mark.parametrize(
    ("script", "name"),
    [
        (NO_WEBGL, "WebGL 2"),
        ("delete window.WebGL2RenderingContext;", "WebGL 2"),
        ("delete window.DecompressionStream;", "DecompressionStream"),
        ("delete window.createImageBitmap;", "createImageBitmap"),
    ],
)
def test_missing_features_are_told(opened: Opened, script: str, name: str) -> None:
    page = opened("colour", script, until=TOLD)
    assert name in page.inner_text("#message")
    assert page.locator("#still").is_visible()
    assert page.evaluate("document.getElementById('still').naturalWidth") == 48
    assert page.locator("button:visible, input:visible").count() == 0


def test_data_that_cannot_be_read_is_told(opened: Opened) -> None:
    broken = "window.createImageBitmap = () => Promise.reject(new Error('no such picture'));"
    page = opened("colour", broken, until=TOLD)
    assert page.inner_text("#message") == "The scene cannot be drawn here: no such picture."
    page = opened("colour")
    page.evaluate("window.dispatchEvent(new ErrorEvent('error', {message: 'out of memory'}))")
    wait_until(page, TOLD)
    assert "out of memory" in page.inner_text("#message")
    assert page.locator("#still").is_visible()


def test_page_without_javascript_shows_a_picture(graphics_browser: Browser, pages: Path) -> None:
    context = graphics_browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto((pages / "colour.html").as_uri(), timeout=TIMEOUT_MS)
    assert "JavaScript" in page.locator("noscript").inner_text()
    assert page.locator("#still").is_visible()
    assert page.locator("button:visible, input:visible").count() == 0
    context.close()


def test_help_and_names_for_those_who_do_not_see(opened: Opened) -> None:
    page = opened("colour")
    canvas = page.locator("#view")
    canvas.focus()
    page.keyboard.press("?")
    assert page.locator("#help").is_visible()
    page.keyboard.press("ArrowRight")
    assert place(page)[0] == 0.0
    page.keyboard.press("Escape")
    assert not page.locator("#help").is_visible()
    assert "viewpoint" in str(canvas.get_attribute("aria-label"))
    page.keyboard.press("ArrowRight")
    assert page.inner_text("#told").startswith("Viewpoint ")
    assert page.get_by_label("m", exact=True).count() == 1
