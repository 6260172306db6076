"""Docstrings of the names of docs/api.md, section by section."""

import importlib
import re
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx

_ROW = re.compile(r"^\* `([\w.]+)`$", re.MULTILINE)


def with_docstrings(text: str) -> str:
    """Add to each list the summaries of its names, and after it their docstrings."""
    head, *sections = re.split(r"^(?=## )", text, flags=re.MULTILINE)
    written = [head]
    for section in sections:
        names = _ROW.findall(section)
        linked = _ROW.sub(lambda row: f"* {{py:obj}}`{row[1]}`: {_summary(row[1])}", section)
        written.append(f"{linked}\n```{{reference}}\n" + "\n".join(names) + "\n```\n\n")
    return "".join(written)


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
