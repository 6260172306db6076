"""Galleries: one file without a request, two pictures over each other, names that cannot run."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser

from dvc.web.document import content_policy, script_json
from dvc.web.gallery import Gallery, Group, Shown, Table, write_gallery
from tests.drawn_pages import Opened, opened_pages

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
def opened(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Opened]:
    """Return a function that opens a gallery of two groups, one with a hostile name."""
    folder = tmp_path_factory.mktemp("gallery")
    write_gallery(folder / "index.html", made_up())
    with opened_pages(browser, folder, "true", (1280, 900)) as opened:
        yield opened


def test_page_is_whole_and_safe(opened: Opened) -> None:
    """Hostile names do not run, and all pictures are there; at the end nothing was logged or requested."""
    page = opened("index")
    assert page.evaluate("window.stolen") is None
    assert page.evaluate("[...document.images].every((image) => image.complete && image.naturalWidth > 0)")
    assert page.locator("section[data-group] img").count() == 6
    assert page.locator("img:not([alt]), th:not([scope]), table:not(:has(caption))").count() == 0


def test_pictures_are_compared(opened: Opened) -> None:
    """Slider and pointer move the border; choices change the pictures and keep what there is."""
    page = opened("index")
    split = "document.querySelector('.compare').style.getPropertyValue('--split')"
    over = page.locator(".compare img.over")
    page.get_by_role("slider").focus()
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


def test_page_fits_a_phone_and_lives_without_scripts(opened: Opened) -> None:
    """At 360 pixels nothing is wider than the screen; without scripts no dead control is shown."""
    page = opened("index", viewport={"width": 360, "height": 740}, java_script_enabled=False)
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    assert page.locator("section[data-group] img:visible").count() == 6
    assert page.locator("select:visible, input:visible").count() == 0


def test_names_of_bytes_that_are_no_characters_are_shown_as_they_can_be(tmp_path: Path) -> None:
    write_gallery(tmp_path / "index.html", Gallery("Surfaces", "Of \udcff.png", []))
    assert "Of ?.png" in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_large_pictures_are_shown_smaller(tmp_path: Path) -> None:
    picture = np.zeros((100, 5000, 3), np.uint8)
    write_gallery(tmp_path / "index.html", Gallery("a", "b", [Group("c", (Shown("d", picture),))]))
    text = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert 'width="1600" height="32"' in text
    assert len(text) < 60_000


def test_scripts_and_data_cannot_be_broken_out_of() -> None:
    policy = content_policy(["a();"])
    assert "default-src 'none'" in policy
    assert "script-src 'sha256-" in policy
    assert "<" not in script_json({"</script>": "&"})
