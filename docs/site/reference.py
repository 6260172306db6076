"""Docstrings of the names of docs/api.md, section by section."""

import importlib
import re
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx

_NAMES = re.compile(r"^```text\n(.*?)^```\n", re.MULTILINE | re.DOTALL)


def names(text: str) -> list[str]:
    """Return the names that a document lists."""
    return [name for block in _NAMES.findall(text) for name in block.split()]


def with_docstrings(text: str) -> str:
    """Replace each block of names by links with summaries, and the docstrings."""
    return _NAMES.sub(_documented, text)


def _documented(block: re.Match[str]) -> str:
    links = "".join(f"* {{py:obj}}`{name}`: {_summary(name)}\n" for name in block[1].split())
    return f"{links}\n```{{reference}}\n{block[1]}```\n"


def _named(name: str) -> Any:
    """Import a name."""
    module, _, attribute = name.rpartition(".")
    return getattr(importlib.import_module(module), attribute)


def _summary(name: str) -> str:
    """Return the first line of a docstring."""
    return str(_named(name).__doc__).strip().splitlines()[0]


class Reference(Directive):
    """The docstrings of some names."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Document each name by autodoc."""
        lines = []
        for name in self.content:
            kind = "autoclass" if isinstance(_named(name), type) else "autofunction"
            lines += [f".. {kind}:: {name}", *(["   :members:"] if kind == "autoclass" else []), ""]
        node = nodes.container()
        self.state.nested_parse(StringList(["```{eval-rst}", *lines, "```"], "reference"), 0, node)
        return node.children


def _read(app: Sphinx, docname: str, source: list[str]) -> None:
    if docname == "api":
        source[0] = with_docstrings(source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_directive("reference", Reference)
    app.connect("source-read", _read, priority=200)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
