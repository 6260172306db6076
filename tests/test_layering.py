"""Who may import whom: the layers of docs/tour.md."""

import ast
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("dvc", "encoder", "decoder", "sequences", "sfm")
FILE_AND_NETWORK = {"argparse", "av", "http", "logging", "multiprocessing", "pathlib", "socket", "subprocess"}


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


def imported_by(path: Path) -> set[str]:
    """Return the absolute names of all modules that a file imports, late imports included."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            base = node.module or ""
            names |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
    return names


@cache
def all_imports() -> dict[str, set[str]]:
    """Return what each module imports."""
    paths = (path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    return {module_name(path): imported_by(path) for path in paths}


def within(name: str, *packages: str) -> bool:
    return any(name == package or name.startswith(package + ".") for package in packages)


def importers(*packages: str) -> dict[str, set[str]]:
    return {name: imports for name, imports in all_imports().items() if within(name, *packages)}


def offenders(modules: dict[str, set[str]], *forbidden: str) -> list[str]:
    return [
        f"{module} -> {name}"
        for module, names in modules.items()
        for name in sorted(names)
        if within(name, *forbidden)
    ]


def test_dvc_imports_no_sibling() -> None:
    """The shared library knows none of the others; its experiments start them as processes."""
    siblings = ("encoder", "decoder", "sequences", "sfm", "benchmarks", "tests")
    experiments = {"dvc.rd": ("benchmarks.thesis",), "benchmarks.thesis": ()}
    contracts = "dvc.contracts"  # tests, which no module imports
    apart = (*experiments, contracts)
    library = {name: names for name, names in importers("dvc").items() if not within(name, *apart)}
    assert offenders(library, contracts) == []
    assert offenders(library, *siblings, *experiments) == []
    for package, others in experiments.items():
        assert offenders(importers(package), *siblings, *others) == []


@pytest.mark.parametrize("package", ["encoder", "decoder", "sequences"])
def test_siblings_share_only_dvc(package: str) -> None:
    """Encoder, decoder and test material know the shared library and nothing of each other."""
    others = {"encoder", "decoder", "sequences", "dvc.rd", "benchmarks", "tests"} - {package}
    assert offenders(importers(package), *others) == []


def test_private_modules_stay_in_their_package() -> None:
    """A module with an underscore is imported by its neighbours alone; the door to numba is for all."""
    found = []
    for module, names in all_imports().items():
        for name in names:
            parent, _, last = name.rpartition(".")
            private = last.startswith("_") and not last.startswith("__") and name in all_imports()
            if private and name != "dvc._jit" and not within(module, parent):
                found.append(f"{module} -> {name}")
    assert found == []


def test_numba_has_one_door() -> None:
    """Only `dvc._jit` imports numba, so that all kernels are compiled alike."""
    modules = {name: names for name, names in all_imports().items() if name != "dvc._jit"}
    assert offenders(modules, "numba") == []


def test_algorithms_do_no_input_and_output() -> None:
    """Codes, transforms, prediction and the feedback state machines know neither files nor sockets."""
    pure = importers(
        "dvc.slepian_wolf",
        "dvc.wynerziv",
        "dvc.entropy",
        "dvc.geometry",
        "decoder.side_information",
        "dvc.bits",
        "dvc.metrics",
    )
    pure |= importers("decoder.wyner_ziv", "encoder.wyner_ziv", "encoder.groups")
    pure |= {
        f"dvc.feedback.{name}": all_imports()[f"dvc.feedback.{name}"] for name in ("endpoints", "messages")
    }
    for name in ("camera_files", "camera_estimation"):  # they read cameras of files
        del pure[f"dvc.geometry.{name}"]
    assert offenders(pure, *FILE_AND_NETWORK) == []


def test_no_module_hides_one_of_the_standard_library() -> None:
    """No name of ours is also one of Python's."""
    import sys

    top_level = {name.rpartition(".")[2] for name in all_imports()} - {"__main__"}
    assert top_level & {"io", "struct", "types", "queue", "random", "signal", "code"} == set()
    assert not set(PACKAGES) & set(sys.stdlib_module_names)


def test_a_frame_passes_few_modules() -> None:
    """At most 7 at the encoder and 13 at the decoder, all of which exist."""
    text = (ROOT / "docs" / "tour.md").read_text(encoding="utf-8")
    for side, most in (("encoder", 7), ("decoder", 13)):
        table = text.partition(f"| at the {side} |")[2].partition("\n\n")[0]
        modules = [line.split("`")[1] for line in table.splitlines()[2:]]
        assert 0 < len(modules) <= most
        assert all((ROOT / module).is_file() for module in modules)
