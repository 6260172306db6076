"""The sources of the packages: lines of code, lengths of files and functions, and who imports whom."""

import ast
import io
import tokenize
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.figures.harness import Figure, Measured, Setting
from benchmarks.figures.house.revisions import BASE, PACKAGES, PROGRAMS, TREE, base_tree

AREA = "house"
MAX_FUNCTION_LINES = 40
MAX_FILE_LINES = 350
MAX_ENTRIES = 6
NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
    tokenize.ENCODING,
}
FORBIDDEN: Mapping[str, tuple[str, ...]] = {
    "dvc.rd": ("encoder", "decoder", "sfm", "sequences"),
    "dvc": ("encoder", "decoder", "sfm", "sequences", "dvc.rd"),
    "sfm": ("encoder", "decoder", "sequences", "dvc.rd"),
    "encoder": ("decoder", "sfm", "sequences", "dvc.rd", "dvc.multiview"),
    "decoder": ("encoder", "sequences", "dvc.rd"),
    "sequences": ("encoder", "decoder", "sfm", "dvc.rd"),
}
"""What lies above a package, or beside it behind a wall; a module belongs to the first that it lies in."""
KERNELS = "compiled loops share a file, for caches miss edits of a callee in another one"
REASONS: Mapping[str, str] = {}
"""Why files other than kernels are longer than most."""


@dataclass(frozen=True)
class Source:
    """One file of Python."""

    name: str  # path within the tree, with slashes
    text: str  # what it holds

    def code_lines(self) -> set[int]:
        """Number the lines of code: those with anything but comments and strings that nobody reads."""
        lines: set[int] = set()
        for token in tokenize.generate_tokens(io.StringIO(self.text).readline):
            if token.type not in NO_CODE:
                lines |= set(range(token.start[0], token.end[0] + 1))
        for node in ast.walk(ast.parse(self.text)):
            match node:
                case ast.Expr(value=ast.Constant(value=str())):
                    assert node.end_lineno is not None
                    lines -= set(range(node.lineno, node.end_lineno + 1))
        return lines

    def functions(self) -> Iterator[tuple[str, int]]:
        """Measure functions and methods."""
        code = self.code_lines()
        for node in ast.walk(ast.parse(self.text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                assert node.end_lineno is not None
                yield (
                    f"{self.name}:{node.lineno} {node.name}",
                    len(code & set(range(node.lineno, node.end_lineno + 1))),
                )

    def imports(self) -> set[str]:
        """Name what is imported, wherever in the file."""
        names: set[str] = set()
        for node in ast.walk(ast.parse(self.text)):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names |= {f"{node.module}.{alias.name}" for alias in node.names}
        return names


@dataclass(frozen=True)
class Packages:
    """All files of the packages of a checkout."""

    sources: tuple[Source, ...]

    @classmethod
    def of(cls, tree: Path) -> "Packages":
        """Read the packages of a checkout."""
        paths = sorted(path for package in PACKAGES for path in (tree / package).rglob("*.py"))
        return cls(
            tuple(
                Source(path.relative_to(tree).as_posix(), path.read_text(encoding="utf-8")) for path in paths
            )
        )

    def num_code_lines(self) -> int:
        """Count lines of code."""
        return sum(len(source.code_lines()) for source in self.sources)

    def long_functions(self) -> dict[str, int]:
        """Return the lines of code of the functions that are too long to be read at once."""
        measured = [pair for source in self.sources for pair in source.functions()]
        return {name: length for name, length in measured if length > MAX_FUNCTION_LINES}

    def long_files(self) -> dict[str, int]:
        """Return the lines, of any kind, of the files that are too long."""
        lengths = {source.name: source.text.count("\n") for source in self.sources}
        return {name: length for name, length in lengths.items() if length > MAX_FILE_LINES}

    def upward_imports(self) -> list[str]:
        """List imports of what lies above a package: one arrow for each module and package above it."""
        arrows = []
        for source in self.sources:
            module = source.name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
            package = next(package for package in FORBIDDEN if _within(module, package))
            above = [name for name in FORBIDDEN[package] if any(_within(i, name) for i in source.imports())]
            arrows += [f"{module} -> {name}" for name in above]
        return arrows


def _within(name: str, package: str) -> bool:
    return name == package or name.startswith(f"{package}.")


def _before_and_now() -> tuple[Packages, Packages]:
    with base_tree() as tree:
        return Packages.of(tree), Packages.of(TREE)


def _code(_setting: Setting, _clip: str) -> Measured:
    before, now = (packages.num_code_lines() for packages in _before_and_now())
    change = 100 * (now / before - 1)
    values = {"lines_before": before, "lines": now}
    return Measured(f"{before} → {now} ({change:+.1f} %)", now < before, values)


def _functions(_setting: Setting, _clip: str) -> Measured:
    before, now = (packages.long_functions() for packages in _before_and_now())
    return Measured(f"{len(before)} → {len(now)}", len(now) < len(before), {"lines_of": now})


def reason(file: str) -> str | None:
    """Say why a file is long."""
    return KERNELS if Path(file).name == "_kernels.py" else REASONS.get(file)


def _files(_setting: Setting, _clip: str) -> Measured:
    before, now = (packages.long_files() for packages in _before_and_now())
    bare = [name for name in now if reason(name) is None]
    named = "; ".join(f"{name} ({length}): {reason(name) or 'NO REASON'}" for name, length in now.items())
    text = f"{len(before)} → {len(now)}, {len(bare)} without a reason"
    return Measured(text, not bare, {"lines_of": now}, named)


def _arrows(_setting: Setting, _clip: str) -> Measured:
    before, now = (packages.upward_imports() for packages in _before_and_now())
    return Measured(f"{len(before)} → {len(now)}", not now, {"arrows_before": before, "arrows": now})


def entries(folder: Path) -> list[str]:
    """List what a newcomer sees in a package: modules and packages that are not private."""
    shown = [path for path in folder.iterdir() if path.is_dir() or path.suffix == ".py"]
    return sorted(path.name for path in shown if not path.name.startswith(("_", ".")))


def _rooms(_setting: Setting, _clip: str) -> Measured:
    room = Path("decoder") / "side_information"
    with base_tree() as tree:
        before = entries(tree / room)
    now = entries(TREE / room)
    return Measured(f"{len(before)} → {len(now)}", len(now) <= MAX_ENTRIES, {"entries": now}, ", ".join(now))


FIGURES = (
    Figure(
        AREA,
        "code-lines",
        f"lines of code of the packages, comments, docstrings and blank lines apart, since {BASE[:7]}",
        "fewer",
        _code,
        programs=PROGRAMS,
    ),
    Figure(
        AREA,
        "long-functions",
        f"functions above {MAX_FUNCTION_LINES} lines of code, docstring apart, since {BASE[:7]}",
        "fewer",
        _functions,
        programs=PROGRAMS,
    ),
    Figure(
        AREA,
        "long-files",
        f"files above {MAX_FILE_LINES} lines, comments and all, since {BASE[:7]}",
        "none without a reason",
        _files,
        programs=PROGRAMS,
    ),
    Figure(
        AREA,
        "upward-imports",
        f"import arrows that run upward, since {BASE[:7]}",
        "0",
        _arrows,
        programs=PROGRAMS,
    ),
    Figure(
        AREA,
        "side-information-rooms",
        f"modules and rooms in decoder/side_information, private ones apart, since {BASE[:7]}",
        f"≤ {MAX_ENTRIES}",
        _rooms,
        programs=PROGRAMS,
    ),
)
"""Figures of this module."""
