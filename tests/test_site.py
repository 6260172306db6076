"""The documentation site: every page is reached, every link leads somewhere, options are the parsers' own."""

import argparse
import importlib
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
MAX_BYTES = 300_000
"""Of all pages, pictures apart."""


@pytest.fixture(scope="module")
def site() -> Iterator[dict[str, ModuleType]]:
    """Import the extensions of Sphinx that the site has."""
    names = [path.stem for path in (DOCS / "site").glob("*.py") if path.stem not in ("conf", "shell")]
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(DOCS / "site")
        yield {name: importlib.import_module(name) for name in names}
    for name in names:
        del sys.modules[name]


def toctree(page: Path) -> list[Path]:
    """Return the pages that a page has in its tables of contents."""
    found = []
    for block in re.findall(r"^```\{toctree\}\n(.*?)^```", page.read_text(), flags=re.MULTILINE | re.DOTALL):
        entries = [line for line in block.splitlines() if line and not line.startswith(":")]
        names = [re.sub(r".*<(.*)>", r"\1", entry) for entry in entries]
        found += [(page.parent / f"{name}.md").resolve() for name in names]
    return found


def slugs(text: str) -> set[str]:
    """Return the anchors of the headings of a document."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def test_every_page_is_in_one_table_of_contents() -> None:
    reached = [DOCS / "index.md"]
    for page in reached:
        reached += toctree(page)
        assert len(reached) <= len(PAGES)
    assert sorted(reached) == PAGES


def test_included_files_exist(site: dict[str, ModuleType]) -> None:
    for page in PAGES:
        for name in re.findall(r"^```\{(?:literal)?include\} (\S+)", page.read_text(), flags=re.MULTILINE):
            assert (page.parent / name).is_file()
    start = site["sources"].page_text(DOCS / "start.md")
    assert "{include}" not in start
    assert "](usage.md)" in start
    assert "](docs/" not in start


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_links_lead_to_places(page: Path, site: dict[str, ModuleType]) -> None:
    text = re.sub(r"^```.*?^```", "", site["sources"].page_text(page), flags=re.MULTILINE | re.DOTALL)
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#\s]*)#?([^)\s]*)\)", text):
        file = (page.parent / target).resolve() if target else page
        assert file.is_file(), target
        assert not anchor or anchor in slugs(site["sources"].page_text(file)), (target, anchor)


def test_pages_are_small() -> None:
    shown = [ROOT / "README.md", ROOT / "CHANGELOG.md", *PAGES]
    assert sum(page.stat().st_size for page in shown) <= MAX_BYTES


def test_commands_have_all_options(site: dict[str, ModuleType]) -> None:
    """The page of the commands has every command, subcommand and option of the parsers."""
    parsers = site["commands"].parsers()
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    assert set(parsers) == set(scripts)
    shown = "\n".join(site["commands"]._section(name, one).astext() for name, one in parsers.items())
    inner = [one for parser in parsers.values() for one in site["commands"].subparsers(parser)]
    assert len(inner) > 10
    for parser in [*parsers.values(), *inner]:
        assert parser.prog in shown
        for action in parser._actions:
            if not isinstance(action, argparse._HelpAction):
                assert all(option in shown for option in action.option_strings)


def test_reference_has_docstrings(site: dict[str, ModuleType]) -> None:
    text = (DOCS / "api.md").read_text(encoding="utf-8")
    names = site["reference"].names(text)
    assert len(names) > 100
    written = site["reference"].with_docstrings(text)
    assert re.findall(r"^\* \{py:obj\}`([\w.]+)`: [A-Z].*\.$", written, flags=re.MULTILINE) == names
    assert re.findall(r"^(\w[\w.]+\.\w+)$", written, flags=re.MULTILINE) == names


def test_chapters_have_what_the_glossary_has(site: dict[str, ModuleType]) -> None:
    """Each section and equation of the glossary is on the page of its chapter, with figures."""
    glossary = (DOCS / "glossary.md").read_text(encoding="utf-8")
    found = sum(len(site["chapters"].terms(chapter)) for chapter in range(2, 6))
    assert found == len(re.findall(r"\[Maitre2008\] (?:Eq|Sec)", glossary))
    assert site["chapters"].terms(2)[0][0].startswith("Sec. 2.5.1")
    assert "| 5.14 |" in site["chapters"].chapter_text(5)


def test_broken_links_are_found(site: dict[str, ModuleType], tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<a href="b.html#there">1</a><a href="b.html#not">2</a><a href="c.html">3</a><a href="#own">4</a>'
        '<h1 id="own">x</h1><a href="https://example.org">5</a><img src="https://example.org/x.png">'
        '<script src="//example.org/x.js"></script><img src="data:image/png;base64,AA">',
        encoding="utf-8",
    )
    (tmp_path / "b.html").write_text('<p id="there">', encoding="utf-8")
    assert site["links"].broken_links(tmp_path) == [
        "a.html: loads //example.org/x.js",
        "a.html: no place b.html#not",
        "a.html: no file c.html",
        "a.html: loads https://example.org/x.png",
    ]
