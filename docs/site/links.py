"""Links of the built site: each leads to a page and a place in it, and nothing is loaded from a network."""

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from sphinx.application import Sphinx
from sphinx.errors import SphinxError

LOADED = {"script": "src", "img": "src", "link": "href", "iframe": "src", "video": "src", "source": "src"}
"""What a browser loads with a page, by the attribute that names it."""


class _Page(HTMLParser):
    """Places, links and parts of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.places: set[str] = set()
        self.links: set[str] = set()
        self.parts: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.places |= {values[name] for name in ("id", "name") if name in values}
        if tag == "a" and "href" in values:
            self.links.add(values["href"])
        if tag in LOADED and LOADED[tag] in values:
            self.parts.add(values[LOADED[tag]])


def _html_files(folder: Path) -> list[Path]:
    """Return the pages; what the theme keeps for itself is none."""
    return sorted(path for path in folder.rglob("*.html") if "_static" not in path.relative_to(folder).parts)


def broken_links(folder: Path) -> list[str]:
    """Return what is wrong, a line for each link."""
    pages = {path.resolve(): _Page(path.read_text(encoding="utf-8")) for path in _html_files(folder)}
    return [
        f"{path.relative_to(folder.resolve())}: {problem}"
        for path, page in pages.items()
        for problem in _problems(path, page, pages)
    ]


def _problems(path: Path, page: _Page, pages: dict[Path, _Page]) -> Iterator[str]:
    for link in sorted(page.links | page.parts):
        parts = urlsplit(link)
        if parts.scheme or parts.netloc:
            if link in page.parts and parts.scheme != "data":
                yield f"loads {link}"
            continue
        file = (path.parent / unquote(parts.path)).resolve() if parts.path else path
        if not file.is_file():
            yield f"no file {link}"
        elif parts.fragment and file in pages and unquote(parts.fragment) not in pages[file].places:
            yield f"no place {link}"


def _check(app: Sphinx, exception: Exception | None) -> None:
    if exception is not None or app.builder.name != "html" or app.config.nb_execution_mode == "off":
        return  # tutorials have made no pages
    if found := broken_links(Path(app.outdir)):
        raise SphinxError("links that lead nowhere:\n" + "\n".join(found))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("build-finished", _check, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
