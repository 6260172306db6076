"""What docs/api.md lists, with its whole docstrings: a page of each section."""

import re

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx

_ROW = re.compile(r"^\| `([\w.]+)` \| ", re.MULTILINE)


def with_docstrings(text: str) -> str:
    """Put the docstrings of the names of each table behind it."""
    head, *sections = re.split(r"^(?=## )", text, flags=re.MULTILINE)
    written = [head]
    for section in sections:
        names = _ROW.findall(section)
        linked = _ROW.sub(r"| {py:obj}`\1` | ", section)
        written.append(f"{linked}\n```{{reference}}\n" + "\n".join(names) + "\n```\n\n")
    return "".join(written)


class Reference(Directive):
    """The docstrings of some names."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Document each name by autodoc."""
        import importlib

        lines = []
        for name in self.content:
            module, _, attribute = name.rpartition(".")
            thing = getattr(importlib.import_module(module), attribute)
            kind = "autoclass" if isinstance(thing, type) else "autofunction"
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
