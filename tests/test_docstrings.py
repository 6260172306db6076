"""Docstrings: numpydoc for what docs/api.md lists, one line for all else."""

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from numpydoc.validate import validate

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("dvc", "encoder", "decoder", "sfm", "sequences")
LISTED = re.findall(r"^\w+(?:\.\w+)+$", (ROOT / "docs" / "api.md").read_text(), flags=re.MULTILINE)
# RT01 takes properties for functions, PR03 refuses `a, b` in one entry.
CHECKS = {"GL01", "GL02", "GL03", "GL05", "GL08", "SS02", "SS03", "PR01", "PR02", "YD01"}
SECTION = re.compile(
    r"^ *(Parameters|Returns|Attributes|Yields|Raises|Notes|References)\n *-{4,}$", re.MULTILINE
)
MAX_LINES = 3  # of what is not in the reference

Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def find(name: str) -> Any:
    """Import what a dotted name stands for."""
    module, _, attribute = name.rpartition(".")
    return getattr(importlib.import_module(module), attribute)


def definitions() -> Iterator[tuple[str, Definition]]:
    """Yield all functions, classes and methods of the packages by their dotted names."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            module = (
                path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".").removesuffix(".__init__")
            )
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, Definition):
                    yield f"{module}.{node.name}", node
                    for inner in node.body if isinstance(node, ast.ClassDef) else []:
                        if isinstance(inner, Definition):
                            yield f"{module}.{node.name}.{inner.name}", inner


def home(name: str) -> str:
    """Return where what is listed is defined."""
    thing = find(name)
    return f"{thing.__module__}.{thing.__qualname__}"


@pytest.mark.parametrize("name", LISTED)
def test_reference_is_documented(name: str) -> None:
    """What is listed, or each method of a listed class that has sections, passes numpydoc."""
    thing = find(name)
    items = {home(name): thing}
    if isinstance(thing, type):
        items |= {f"{home(name)}.{member}": getattr(thing, member) for member in vars(thing)}
    sections = {where: item for where, item in items.items() if SECTION.search(str(item.__doc__))}
    assert sections
    for where, item in sections.items():
        errors = dict(validate(where)["errors"])
        if isinstance(item, type) and ("Attributes\n" in str(item.__doc__) or "__init__" not in vars(item)):
            errors.pop("PR01", None)  # fields are documented as attributes
        assert {code: text for code, text in errors.items() if code in CHECKS} == {}


def test_all_else_has_short_docstrings() -> None:
    """What is not in the reference has up to three lines without sections; what is public has some."""
    listed = {home(name) for name in LISTED}
    wrong = []
    for name, node in definitions():
        text = ast.get_docstring(node) or ""
        if name in listed or name.rpartition(".")[0] in listed:
            continue
        if SECTION.search(text) or len([line for line in text.splitlines() if line]) > MAX_LINES:
            wrong.append(f"{name}: sections or more than {MAX_LINES} lines")
        elif not text and not re.search(r"\._", name):
            wrong.append(f"{name}: no docstring")
    assert wrong == []
