"""The page in a real browser: charts, controls, a phone, the dark, paper, and no request to anywhere."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from playwright.sync_api import Browser, Page

from dvc.rd.rd_page import write_page
from dvc.rd.rd_results import read_folders
from tests import browser as browsers
from tests.rd.made_up_page import write_many

PHONE_PX = {"width": 360, "height": 740}
DESKTOP_PX = {"width": 1280, "height": 900}
TIMEOUT_MS = 60_000


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the address of a page of 3 sequences and 5 curves, some with hostile names."""
    folder = write_many(tmp_path_factory.mktemp("browser") / "results")
    path = folder / "report.html"
    write_page(read_folders([folder])[0], path)
    return path.as_uri()


@contextmanager
def opened_page(
    browser: Browser, address: str | None, viewport: dict[str, int] = DESKTOP_PX, **options: Any
) -> Iterator[Page]:
    """Open a tab, and the page in it unless its address is None."""
    context = browser.new_context(viewport=viewport, **options)  # type: ignore[arg-type]
    page = context.new_page()
    page.set_default_timeout(TIMEOUT_MS)
    if address is not None:
        page.goto(address)
    yield page
    context.close()


@pytest.fixture(scope="module")
def page(browser: Browser, address: str) -> Iterator[Page]:
    with opened_page(browser, address) as page:
        page.wait_for_selector("[data-rd] .scatterlayer path.js-line", state="attached")
        yield page


def num_lines(page: Page, slug: str) -> int:
    return page.locator(f'[data-rd="{slug}"] .scatterlayer path.js-line').count()


def test_page_opens_without_an_error_or_a_request(browser: Browser, address: str) -> None:
    with opened_page(browser, None) as opened:
        logged: list[str] = []
        requests: list[str] = []
        opened.on("console", lambda message: logged.append(message.text))
        opened.on("pageerror", lambda error: logged.append(str(error)))
        opened.on("request", lambda request: requests.append(request.url))
        opened.goto(address)
        opened.wait_for_selector("[data-rd] .scatterlayer path.js-line", state="attached")
        for figure in opened.locator("figure.chart").all():
            figure.scroll_into_view_if_needed()
        browsers.wait_until(
            opened, "document.querySelectorAll('.plot.rd:not([hidden]), .plots:not([hidden])').length == 6"
        )
        assert logged == []
        assert {url.split(":", 1)[0] for url in requests} <= {"file", "data", "blob"}
        assert [url for url in requests if url.startswith("file:")] == [address]
        assert opened.evaluate("window.stolen") is None


def test_legend_hides_a_curve(page: Page) -> None:
    box = page.locator('[data-legend="street"] input').nth(1)
    box.scroll_into_view_if_needed()
    page.wait_for_selector('[data-rd="street"] .scatterlayer path.js-line', state="attached")
    assert num_lines(page, "street") == 5
    box.focus()
    page.keyboard.press("Space")
    browsers.wait_until(
        page, "document.querySelectorAll('[data-rd=\"street\"] .scatterlayer path.js-line').length == 4"
    )
    page.keyboard.press("Space")
    browsers.wait_until(
        page, "document.querySelectorAll('[data-rd=\"street\"] .scatterlayer path.js-line').length == 5"
    )


def test_chart_zooms(page: Page) -> None:
    block = page.locator('[data-zoom="street"]')
    range_of = "document.querySelector('[data-rd=\"street\"]')._fullLayout?.xaxis"
    page.locator('figure.chart:has([data-rd="street"])').scroll_into_view_if_needed()
    browsers.wait_until(page, f"{range_of} !== undefined")
    near = page.evaluate(f"{range_of}.range[1]")
    block.get_by_role("button", name="Show all points").click()
    assert page.evaluate(f"{range_of}.range[1]") > near
    block.get_by_label("logarithmic rate").check()
    assert page.evaluate(f"{range_of}.type") == "log"
    block.get_by_label("logarithmic rate").uncheck()


def test_anchor_changes_the_verdict(page: Page) -> None:
    visible = page.locator(".verdict:visible table.matrix")
    assert "against H.264 intra" in visible.locator("caption").inner_text()
    before = visible.locator("tbody").inner_text()
    assert "−" in before
    page.get_by_label("Compare with").select_option(label="2D-DVC, GOP 2")
    assert visible.count() == 1
    assert "against 2D-DVC, GOP 2" in visible.locator("caption").inner_text()
    assert visible.locator("tbody").inner_text() != before
    assert page.get_by_role("status").inner_text() == "The tables compare with 2D-DVC, GOP 2."
    page.get_by_label("Compare with").select_option(label="H.264 intra")


def test_frames_follow_the_choice(page: Page) -> None:
    select = page.locator('[data-view="street"]')
    select.scroll_into_view_if_needed()
    plots = page.locator('[data-frames="street"]')
    page.wait_for_selector('[data-frames="street"] .scatterlayer path.js-line', state="attached")
    assert plots.locator(".one").count() == 4
    assert plots.locator(".one").first.locator(".scatterlayer path.js-line").count() == 4
    select.select_option(label="Q2, key QP 41", force=True)
    assert plots.locator(".one").first.locator(".scatterlayer path.js-line").count() == 3
    assert plots.locator(".barlayer path").count() > 0


def test_slider_moves_the_border(page: Page) -> None:
    block = page.locator('[data-pictures="street"]')
    slider = block.get_by_role("slider")
    slider.scroll_into_view_if_needed()
    slider.focus()
    page.keyboard.press("Home")
    split = "document.querySelector('[data-pictures=\"street\"] .compare').style.getPropertyValue('--split')"
    assert page.evaluate(split) == "0%"
    page.keyboard.press("ArrowRight")
    assert page.evaluate(split) == "1%"
    image = block.locator("img.decoded")
    browsers.wait_until(
        page, "document.querySelector('[data-pictures=\"street\"] img.decoded').naturalWidth == 64"
    )
    before = image.get_attribute("src")
    block.locator("select").select_option(index=1)
    after = image.get_attribute("src")
    assert after is not None
    assert after.startswith("data:image/webp")
    assert after != before
    assert "decoded" in str(image.get_attribute("alt"))


def test_page_fits_a_phone(browser: Browser, address: str) -> None:
    """At 360 pixels nothing but tables in their frames is wider than the screen, charts included."""
    with opened_page(browser, address, PHONE_PX) as opened:
        for figure in opened.locator("figure.chart").all():
            figure.scroll_into_view_if_needed()
        opened.wait_for_selector("[data-frames='street'] .scatterlayer", state="attached")
        opened.evaluate("document.querySelectorAll('details').forEach((part) => { part.open = true; })")
        assert opened.evaluate("document.documentElement.scrollWidth") <= PHONE_PX["width"]


def test_colours_follow_the_dark_and_paper(browser: Browser, address: str) -> None:
    """In the dark, text is light; on paper it is black, all charts are drawn, and details are open."""
    with opened_page(browser, address, color_scheme="dark") as opened:
        opened.wait_for_selector("[data-rd] .scatterlayer path.js-line", state="attached")
        assert opened.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(20, 23, 27)"
        opened.emulate_media(media="print")
        assert opened.evaluate("getComputedStyle(document.body).color") == "rgb(0, 0, 0)"
        assert opened.locator("nav:visible").count() == 0
        colour = "document.querySelector('[data-rd]')._fullLayout.font.color"
        assert opened.evaluate(colour) == "#e8eaed"
        opened.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        assert opened.locator("details:not([open]):visible").count() == 0
        assert opened.evaluate(colour) == "#1b1f24"
        assert opened.locator("[data-rd]:visible .main-svg").count() >= 3
        assert opened.locator("[data-frames]:visible .one").count() >= 3
        assert opened.locator("[data-costs]:visible .point").count() == 5
        opened.evaluate("window.dispatchEvent(new Event('afterprint'))")
        assert opened.evaluate(colour) == "#e8eaed"


def test_page_can_be_read_without_a_pointer(page: Page) -> None:
    """Controls have names, tables captions, images a text; the first key leads past the menu."""
    nameless = page.evaluate(
        """[...document.querySelectorAll('select, input, button')].filter((control) => !control.labels?.length
        && !control.getAttribute('aria-label') && !control.textContent.trim()).length"""
    )
    assert nameless == 0
    assert page.locator("table:not(:has(caption))").count() == 0
    assert page.locator("th:not([scope])").count() == 0
    assert page.locator("img:not([alt])").count() == 0
    names = page.evaluate("[...document.querySelectorAll('[id]:not(svg *)')].map((element) => element.id)")
    assert len(set(names)) == len(names)
    page.reload()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"


def test_page_without_scripts_shows_tables(browser: Browser, address: str) -> None:
    with opened_page(browser, address, java_script_enabled=False) as opened:
        assert opened.get_by_text("Charts are drawn only with JavaScript").count() == 3
        assert opened.locator("figure.chart:visible").count() == 0
        assert opened.locator(".verdict:visible table.matrix").count() == 1
        assert opened.locator("select:visible, button:visible, input:visible").count() == 0
