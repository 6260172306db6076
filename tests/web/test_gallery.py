"""Galleries: one file without a request, two pictures over each other, names that cannot run."""

from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from dvc.web.document import content_policy, script_json
from dvc.web.gallery import Gallery, Group, Shown, Table, write_gallery

TIMEOUT_MS = 60_000
HOSTILE = '"><script>window.stolen = 1</script>'


def made_up() -> Gallery:
    rng = np.random.default_rng(0)
    groups = [
        Group(
            name,
            tuple(
                Shown(kind, rng.integers(0, 256, (30, width, 3)).astype(np.uint8), "text")
                for kind in ("view", "disparity", "occluded")
            ),
        )
        for name, width in (("left", 40), (HOSTILE, 60))
    ]
    table = Table("Views", "What each shows", ("view", "bad"), (("left", "1.5 %"), (HOSTILE, "2 %")))
    return Gallery("Surfaces", f"Of {HOSTILE}", groups, [table], [f"a note {HOSTILE}"])


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the address of a gallery of two groups, one with a hostile name."""
    path = tmp_path_factory.mktemp("gallery") / "index.html"
    write_gallery(path, made_up())
    return path.as_uri()


def test_page_opens_without_an_error_or_a_request(browser: Browser, address: str) -> None:
    """Nothing is logged, nothing is loaded, hostile names do not run, and all pictures are there."""
    page = browser.new_page()
    logged: list[str] = []
    requests: list[str] = []
    page.on("console", lambda message: logged.append(message.text))
    page.on("pageerror", lambda error: logged.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(address, timeout=TIMEOUT_MS)
    assert logged == []
    assert [url for url in requests if not url.startswith("data:")] == [address]
    assert page.evaluate("window.stolen") is None
    assert page.evaluate("[...document.images].every((image) => image.complete && image.naturalWidth > 0)")
    assert page.locator("section[data-group] img").count() == 6
    assert page.locator("img:not([alt]), th:not([scope]), table:not(:has(caption))").count() == 0
    page.close()


def test_pictures_are_compared(browser: Browser, address: str) -> None:
    """Slider and pointer move the border; choices change the pictures and keep what there is."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto(address, timeout=TIMEOUT_MS)
    split = "document.querySelector('.compare').style.getPropertyValue('--split')"
    over = page.locator(".compare img.over")
    slider = page.get_by_role("slider")
    slider.focus()
    page.keyboard.press("Home")
    assert page.evaluate(split) == "0%"
    page.locator(".compare").hover()
    assert page.evaluate(split) == "50%"
    before = over.get_attribute("src")
    page.get_by_label("right", exact=True).select_option("occluded")
    assert over.get_attribute("src") != before
    page.get_by_label("Show", exact=True).select_option("1")
    assert str(over.get_attribute("alt")).startswith("occluded of")
    assert over.get_attribute("width") == "60"
    page.close()


def test_page_fits_a_phone_and_lives_without_scripts(browser: Browser, address: str) -> None:
    """At 360 pixels nothing is wider than the screen; without scripts no dead control is shown."""
    context = browser.new_context(viewport={"width": 360, "height": 740}, java_script_enabled=False)
    page = context.new_page()
    page.goto(address, timeout=TIMEOUT_MS)
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    assert page.locator("section[data-group] img:visible").count() == 6
    assert page.locator("select:visible, input:visible").count() == 0
    context.close()


def test_names_of_bytes_that_are_no_characters_are_shown_as_they_can_be(tmp_path: Path) -> None:
    """Names of files need not be text."""
    write_gallery(tmp_path / "index.html", Gallery("Surfaces", "Of \udcff.png", []))
    assert "Of ?.png" in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_large_pictures_are_shown_smaller(tmp_path: Path) -> None:
    """A picture of many pixels does not make a page of many bytes."""
    picture = np.zeros((100, 5000, 3), np.uint8)
    write_gallery(tmp_path / "index.html", Gallery("a", "b", [Group("c", (Shown("d", picture),))]))
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert 'width="1600" height="32"' in text
    assert len(text) < 60_000


def test_scripts_and_data_cannot_be_broken_out_of() -> None:
    """The policy names digests of the scripts alone, and data holds no markup."""
    policy = content_policy(["a();"])
    assert "default-src 'none'" in policy
    assert "script-src 'sha256-" in policy
    assert "<" not in script_json({"</script>": "&"})
