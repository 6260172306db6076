"""Rules of imports that import-linter cannot state: those of modules outside the packages, and of names."""

import ast
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("dvc", "encoder", "decoder", "sequences", "sfm")
FILE_AND_NETWORK = ("argparse", "av", "http", "logging", "multiprocessing", "pathlib", "socket", "subprocess")
ALGORITHMS = (
    "dvc.bits",
    "dvc.entropy",
    "dvc.feedback.endpoints",
    "dvc.feedback.messages",
    "dvc.geometry",
    "dvc.metrics",
    "dvc.slepian_wolf",
    "dvc.wynerziv",
    "decoder.side_information",
    "decoder.wyner_ziv",
    "encoder.groups",
    "encoder.encoder_session",
)
READ_CAMERA_FILES = ("dvc.geometry.camera_estimation", "dvc.geometry.camera_files")


@cache
def imports() -> dict[str, set[str]]:
    """Return the absolute names that each module of the packages imports, late imports included."""
    found: dict[str, set[str]] = {}
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        names = found[".".join(part for part in parts if part != "__init__")] = set[str]()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: relative import"
                base = node.module or ""
                names |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
    return found


def within(name: str, packages: tuple[str, ...]) -> bool:
    return any(name == package or name.startswith(package + ".") for package in packages)


@pytest.mark.parametrize(
    ("importers", "exceptions", "forbidden"),
    [
        (PACKAGES, (), ("benchmarks", "tests")),
        (PACKAGES, ("dvc._jit",), ("numba",)),  # all kernels are compiled alike
        (ALGORITHMS, READ_CAMERA_FILES, FILE_AND_NETWORK),
    ],
)
def test_modules_do_without(
    importers: tuple[str, ...], exceptions: tuple[str, ...], forbidden: tuple[str, ...]
) -> None:
    """Packages need no tests, kernels one door to numba, and algorithms neither files nor sockets."""
    assert all(any(within(module, (name,)) for module in imports()) for name in (*importers, *exceptions))
    assert [
        f"{module} -> {name}"
        for module, names in imports().items()
        if within(module, importers) and not within(module, exceptions)
        for name in sorted(names)
        if within(name, forbidden)
    ] == []


def test_private_modules_stay_in_their_package() -> None:
    """Only neighbours import a module with an underscore; `dvc._jit` is for all packages."""
    modules = {name for name in imports() if name.rpartition(".")[2].startswith("_")} - {"dvc._jit"}
    assert [
        f"{module} -> {name}"
        for module, names in imports().items()
        for name in names & modules
        if not name.endswith("__") and not within(module, (name.rpartition(".")[0],))
    ] == []


def test_no_module_hides_one_of_the_standard_library() -> None:
    assert not set(PACKAGES) & set(sys.stdlib_module_names)
    names = {name.rpartition(".")[2] for name in imports()}
    assert not names & {"io", "struct", "types", "queue", "random", "signal", "code"}
