"""The page of a map in a browser: what is drawn at cameras and between them, how it is moved."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from playwright.sync_api import Browser, Page

from dvc.arrays import Bytes, Mask
from dvc.metrics import psnr_db
from sfm.mapping.scene_map import MapPiece, SceneMap
from sfm.output.scene_folder import write_flight
from tests.browser import wait_until
from tests.drawn_pages import TOLD, Opened, lose_context, opened_pages, restore_context, saved_picture
from tests.sfm.plane_map import frames_of, intrinsics_of, map_of, piece_of, pose_at, view

SIZE = (97, 73)
CLASSES = "document.documentElement.classList"
SETTLED = f"{CLASSES}.contains('ready') && {CLASSES}.contains('settled')"
BACKGROUND = np.array([16, 18, 21])
HOSTILE = '"></script><script>window.stolen = 1</script>'


def maps() -> dict[str, SceneMap]:
    whole = piece_of(range(9), *SIZE, depth_step=4)
    no_points = np.empty((0, 3)), np.empty((0, 3), np.uint8)
    intrinsics, poses = intrinsics_of(*SIZE), {number: pose_at(number) for number in range(9, 12)}
    return {
        "whole": map_of(whole, size=SIZE),
        "pieces": map_of(whole, MapPiece(intrinsics, poses, *no_points, {}), size=SIZE),
        "points": map_of(MapPiece(intrinsics, whole.poses, whole.points, whole.colours, {}), size=SIZE),
        "depths": map_of(MapPiece(intrinsics, whole.poses, *no_points, whole.depths), size=SIZE),
        "nothing": map_of(size=SIZE),
    }


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pages")
    for name, scene in maps().items():
        write_flight(folder / f"{name}.html", scene, frames_of(*SIZE), 10.0, HOSTILE)
    return folder


@pytest.fixture
def opened(graphics_browser: Browser, pages: Path) -> Iterator[Opened]:
    """Return what opens a page."""
    with opened_pages(graphics_browser, pages, SETTLED, (480, 460)) as opening:
        yield opening


def go(page: Page, index: int) -> None:
    page.evaluate(
        "index => { const slider = document.getElementById('frame'); slider.value = index;"
        " slider.dispatchEvent(new Event('input')); }",
        index,
    )
    settle(page)


def settle(page: Page) -> None:
    """Wait until what was asked for last is drawn."""
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    wait_until(page, SETTLED)


def saved(page: Page) -> Bytes:
    settle(page)
    return saved_picture(page)


def seen(page: Page) -> Bytes:
    """Return the canvas as it stands on the page, without the outline of the focus."""
    settle(page)
    coded = np.frombuffer(page.locator("#view").screenshot(), np.uint8)
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)[5:-5, 5:-5]


def quality(found: Bytes, wanted: Bytes) -> float:
    """Return the PSNR of all channels in dB."""
    return psnr_db(found.reshape(-1, 3), wanted.reshape(-1, 3))


def drawn(picture: Bytes) -> Mask:
    """Tell where a picture is not the background."""
    return np.asarray(np.abs(picture.astype(int) - BACKGROUND).max(axis=2) > 2)


@pytest.mark.parametrize("shown", ["surfaces", "both"])
def test_cameras_show_their_frames(opened: Opened, shown: str) -> None:
    """With exact depth the view is the frame, at cameras of pictures with depth and between them."""
    page = opened("whole")
    page.check("#ride")
    page.check(f"#{shown}")
    inside = np.s_[8:-8, 8:-8]
    for number, quality_db in ((0, 34.0), (4, 34.0), (2, 29.0), (5, 29.0)):
        go(page, number)
        found, wanted = saved(page), view(number, *SIZE)[0]
        assert found.shape == wanted.shape
        assert drawn(found)[inside].mean() > 0.99
        assert quality(found[inside], wanted[inside]) > quality_db


def test_points_are_where_they_are_seen(opened: Opened) -> None:
    """They cover the view of a camera, in nearly its colours, but for what other cameras did not see."""
    page = opened("points")
    assert page.locator("#surfaces").is_disabled()
    assert page.locator("#points").is_checked()
    page.check("#ride")
    go(page, 4)
    found, wanted = saved(page), view(4, *SIZE)[0]
    where = drawn(found)
    assert where.mean() > 0.5
    assert quality(found[where], wanted[where]) > 20.0


def test_slider_changes_frame_and_picture(opened: Opened) -> None:
    """The label tells number and time, the picture is that of the frame, and its pyramid moves."""
    page = opened("whole")
    page.check("#points")
    before, address = saved(page), page.get_attribute("#picture", "src")
    go(page, 6)
    assert page.inner_text("#number") == "frame 6 · 0.60 s"
    assert page.inner_text("#caption") == "frame 6"
    assert page.get_attribute("#picture", "src") != address
    moved = np.abs(saved(page).astype(int) - before).max(axis=2) > 20
    assert 0.0005 < moved.mean() < 0.3
    page.uncheck("#path")
    without = saved(page)
    go(page, 0)
    np.testing.assert_array_equal(saved(page), without)


def test_flight_plays_to_its_end(opened: Opened) -> None:
    page = opened("whole")
    page.check("#points")
    go(page, 5)
    page.locator("#view").focus()
    page.keyboard.press("Space")
    assert page.inner_text("#play") == "Pause"
    wait_until(page, "document.getElementById('frame').value === '8'")
    wait_until(page, "document.getElementById('play').textContent === 'Play'")
    page.keyboard.press(",")
    settle(page)
    assert page.input_value("#frame") == "7"


def test_view_is_turned_moved_and_reset(opened: Opened) -> None:
    page = opened("whole")
    page.check("#points")
    first = saved(page)
    box = page.locator("#view").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def dragged() -> None:
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 50, y + 20, steps=3)
        page.mouse.up()

    views = [first]
    for change in (
        dragged,
        lambda: page.mouse.wheel(0, -400),
        lambda: page.keyboard.press("Shift+ArrowLeft"),
        lambda: page.keyboard.press("ArrowUp"),
        lambda: page.keyboard.press("-"),
    ):
        change()
        page.locator("#view").focus()
        views.append(saved(page))
        assert (np.abs(views[-1].astype(int) - views[-2]).max(axis=2) > 8).mean() > 0.01
    page.mouse.dblclick(x, y)
    np.testing.assert_array_equal(saved(page), first)


def test_free_views_begin_at_the_camera(opened: Opened) -> None:
    page = opened("depths")
    page.uncheck("#path")
    page.check("#ride")
    page.locator("#view").focus()
    before = seen(page)
    page.keyboard.press("ArrowRight")
    assert page.locator("#free").is_checked()
    turned = seen(page)
    page.keyboard.press("ArrowLeft")
    assert quality(seen(page), before) > quality(turned, before) + 1.0
    page.keyboard.press("c")
    assert page.locator("#ride").is_checked()
    np.testing.assert_array_equal(seen(page), before)


def test_kinds_of_drawing_are_switched(opened: Opened) -> None:
    page = opened("whole")
    assert page.inner_text("h1") == HOSTILE  # markup in a title is text
    assert not page.evaluate("'stolen' in window")
    assert "9 of 12 frames located" in page.inner_text("header")
    page.locator("#view").focus()
    page.keyboard.press("v")
    assert page.locator("#points").is_checked()
    points = saved(page)
    page.keyboard.press("v")
    assert page.locator("#surfaces").is_checked()
    assert drawn(saved(page)).mean() > drawn(points).mean()
    page.keyboard.press("i")
    assert not page.locator("#inset").is_visible()


def test_pieces_are_chosen(opened: Opened) -> None:
    page = opened("pieces")
    whole = drawn(saved(page)).mean()
    page.select_option("#piece", "1")
    settle(page)
    assert page.inner_text("#number") == "frame 9 · 0.90 s"
    assert page.get_attribute("#frame", "max") == "2"
    assert page.locator("#both").is_disabled()
    assert 0.0 < drawn(saved(page)).mean() < whole
    page.select_option("#piece", "0")
    assert drawn(saved(page)).mean() == pytest.approx(whole, abs=0.001)


def test_nothing_is_told(opened: Opened) -> None:
    page = opened("nothing", until=TOLD)
    assert "No frame" in page.inner_text("#message")
    assert page.locator("#still").is_visible()
    assert page.locator("button:visible, input:visible").count() == 0


def test_context_that_is_lost_comes_back(opened: Opened) -> None:
    page = opened("points")
    go(page, 3)
    before = saved(page)
    lose_context(page)
    restore_context(page, SETTLED)
    np.testing.assert_array_equal(saved(page), before)


def test_small_screens_have_all_controls(opened: Opened) -> None:
    page = opened("whole", viewport={"width": 360, "height": 740}, has_touch=True, is_mobile=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    box = page.locator("#view").bounding_box()
    assert box is not None
    assert box["height"] > 250
    page.locator("#help-button").scroll_into_view_if_needed()
    page.click("#help-button")
    assert page.locator("#help").is_visible()
