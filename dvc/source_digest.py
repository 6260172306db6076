"""Digests of what programs consist of: the definitions that they reach, wherever these stand."""

import ast
import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import dvc

_PACKAGES = ("dvc", "encoder", "decoder", "sfm", "sequences", "benchmarks")
_STARTERS = ("dvc.rd.", "benchmarks.thesis.", "benchmarks.")
"""Where a plain name of a package in quotes is that of a program to start."""
_DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Assign, ast.AnnAssign)
_IMPORTS = (ast.Import, ast.ImportFrom)
_LONGEST_NAME = 100
_DATA = (".json", ".js", ".css", ".j2", ".vert", ".frag")
"""Files beside a module that are a part of it."""
Place = tuple[str, str]
"""A module, and a name in it; all of the module if that is empty."""


@dataclass(frozen=True)
class Statement:
    """A statement of a module."""

    digest: str  # of its syntax, without comments, docstrings, formatting and imports from the project
    uses: frozenset[Place]  # what it refers to in the project
    files: tuple[Path, ...]  # files beside the module that it names


@dataclass
class Module:
    """The statements of a module."""

    # definitions, by the names that they bind
    named: dict[str, list[Statement]] = field(default_factory=dict)
    others: list[Statement] = field(default_factory=list)  # what runs whatever is used of the module
    # what names stand for that are imported from the project
    imported: dict[str, Place] = field(default_factory=dict)

    def statements(self, name: str) -> list[Statement]:
        """Return what runs if something of the module is used."""
        chosen = [self.named.get(name, [])] if name else self.named.values()
        return self.others + [statement for each in chosen for statement in each]


class Sources:
    """The code of the project as it is now; every file is read at most once in the life of an instance."""

    def __init__(self) -> None:
        self._modules: dict[str, Module | None] = {}

    def digest(self, places: Iterable[Place]) -> str:
        """Digest all code of the project that runs where something is used."""
        statements = self.reached(places)
        files = {path for statement in statements for path in statement.files}
        parts = sorted({statement.digest for statement in statements})
        parts += sorted(hashlib.sha256(path.read_bytes()).hexdigest() for path in files)
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]

    def reached(self, places: Iterable[Place]) -> set[Statement]:
        """Find all statements that run where something is used."""
        statements: set[Statement] = set()
        seen: set[Place] = set()
        waiting = [_program(*place) for place in places]
        while waiting:
            place = waiting.pop()
            if place in seen:
                continue
            seen.add(place)
            module = self._module(place[0])
            if module is None:
                continue
            if place[1] in module.imported:
                waiting.append(module.imported[place[1]])
            for statement in module.statements(place[1]):
                statements.add(statement)
                waiting += statement.uses - seen
        return statements

    def _module(self, name: str) -> Module | None:
        if name not in self._modules:
            path = _path(name)
            status = None if path is None else path.stat()
            self._modules[name] = (
                None
                if path is None or status is None
                else _read(name, path, status.st_mtime_ns, status.st_size)
            )
        return self._modules[name]


def _program(module: str, name: str) -> Place:
    """Return the place of the program where a package is named that can be run."""
    return (f"{module}.__main__", "") if not name and _path(f"{module}.__main__") else (module, name)


@cache
def _root() -> Path:
    return Path(dvc.__file__).resolve().parents[1]


def _path(module: str) -> Path | None:
    """Return the file of a module of the project."""
    first, *rest = module.split(".")
    if first not in _PACKAGES or not all(part.isidentifier() for part in rest):
        return None
    path = _root().joinpath(first, *rest)
    for candidate in (path.with_name(f"{path.name}.py"), path / "__init__.py"):
        if candidate.is_file():
            return candidate
    return None


@cache
def _read(name: str, path: Path, _changed_ns: int, _num_bytes: int) -> Module:
    """Take a module apart; a file that was changed is read again."""
    module = Module()
    body = [node for node in ast.parse(path.read_bytes()).body if not _is_docstring(node)]
    body = [
        node for node in body if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test))
    ]
    local = {bound: (name, bound) for node in body for bound in _bound(node)}
    for node in body:
        if not isinstance(node, _DEFINITIONS):
            module.imported |= _imports(ast.walk(node))
    for node in body:
        if isinstance(node, _IMPORTS):
            continue
        statement = _statement(node, name, path, local | module.imported)
        for bound in _bound(node):
            module.named.setdefault(bound, []).append(statement)
        if not _bound(node):
            module.others.append(statement)
    return module


def _is_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _bound(node: ast.stmt) -> list[str]:
    """Return the names that a definition binds; none where a statement is no definition."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else []
    targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
    names = [part for target in targets for part in ast.walk(target)]
    if not all(isinstance(part, ast.Name | ast.Tuple | ast.Store) for part in names):
        return []
    return [part.id for part in names if isinstance(part, ast.Name)]


def _imports(nodes: Iterable[ast.AST]) -> dict[str, Place]:
    """Return what names stand for that are imported from the project."""
    found: dict[str, Place] = {}
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                module = alias.name if alias.asname else alias.name.partition(".")[0]
                if _path(alias.name):
                    found[alias.asname or module] = (module, "")
        elif isinstance(node, ast.ImportFrom) and node.module and _path(node.module):
            for alias in node.names:
                within = f"{node.module}.{alias.name}"
                place = (within, "") if _path(within) else (node.module, alias.name)
                found[alias.asname or alias.name] = place
    return found


def _statement(tree: ast.stmt, name: str, path: Path, known: dict[str, Place]) -> Statement:
    nodes = list(ast.walk(tree))
    known = known | _imports(nodes)
    uses, files = _references(nodes, known), []
    described = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    texts = {node.value for node in nodes if isinstance(node, ast.Constant) and id(node) not in described}
    for text in texts:
        if not isinstance(text, str) or len(text) > _LONGEST_NAME:
            continue
        started = text.startswith(_PACKAGES) and ("." in text or name.startswith(_STARTERS))
        if started and _path(text):
            uses.add(_program(text, ""))
        if text.endswith(_DATA) and "/" not in text:
            beside = (path.parent / text, path.parent / "templates" / text)
            files += [file for file in beside if file.is_file()]
    digest = hashlib.sha256(_text(tree).encode()).hexdigest()
    return Statement(digest, frozenset(uses), tuple(sorted(files)))


def _references(nodes: list[ast.AST], known: dict[str, Place]) -> set[Place]:
    """Collect what names, and attributes of modules, refer to."""
    uses, parts = set[Place](), set[int]()
    for node in nodes:
        if id(node) in parts:
            continue
        place = _resolved(node, known)
        if place is not None:
            uses.add(place)
            parts |= {id(part) for part in ast.walk(node)}
    return uses


def _resolved(node: ast.AST, known: dict[str, Place]) -> Place | None:
    if isinstance(node, ast.Name):
        return known.get(node.id)
    if not isinstance(node, ast.Attribute):
        return None
    base = _resolved(node.value, known)
    if base is None or base[1]:
        return base
    module = f"{base[0]}.{node.attr}"
    return (module, "") if _path(module) else (base[0], node.attr)


def _text(node: object) -> str:
    """Write a tree down, alike in all versions of Python, without docstrings and imports of the project."""
    if isinstance(node, list):
        return "[" + ",".join(filter(None, map(_text, node))) + "]"
    if not isinstance(node, ast.AST):
        return repr(node)
    if _is_docstring(node) or (isinstance(node, _IMPORTS) and _imports([node])):
        return ""
    fields = [(key, getattr(node, key, None)) for key in sorted(node._fields) if key != "kind"]
    parts = [f"{key}={_text(value)}" for key, value in fields if value is not None and value != []]
    return f"{type(node).__name__}({' '.join(parts)})"
