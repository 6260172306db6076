"""The tree of tests mirrors the packages: `tests/x/y/test_z.py` is of `dvc/x/y/z.py`, or of `x/y/z.py`.

Tests of a whole package stand in its folder under a name that no module has.
"""

from pathlib import Path, PurePosixPath

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("dvc", "encoder", "decoder", "sequences", "sfm", "benchmarks")
APART = {"contracts", "golden", "reference"}
"""Tests of protocols, frozen streams, and plain twins."""


def _mirrored(path: Path) -> PurePosixPath:
    """Return where the tests of a module are, relative to `tests`; private modules have public tests."""
    module = PurePosixPath(path.relative_to(ROOT).as_posix().removeprefix("dvc/"))
    return module.with_name(f"test_{module.stem.strip('_')}.py")


WITHOUT_TESTS = {PurePosixPath(), PurePosixPath("benchmarks/pictures"), PurePosixPath("testing")}
"""Pictures are looked at, and contracts are tests themselves (`tests/contracts`)."""

MODULES = {
    _mirrored(path)
    for package in PACKAGES
    for path in (ROOT / package).rglob("*.py")
    if path.name != "__init__.py" and "__pycache__" not in path.parts
}
TESTS = {
    PurePosixPath(path.relative_to(ROOT / "tests").as_posix()) for path in ROOT.glob("tests/**/test_*.py")
}


def test_tests_are_where_their_modules_are() -> None:
    """A test in another folder than the only module of its name is not found by who changes that."""
    packages = {f"test_{parent.name}.py" for module in MODULES for parent in module.parents}
    wrong = []
    for test in sorted(test for test in TESTS if len(test.parts) > 1 and test.parts[0] not in APART):
        names = [module.name for module in MODULES if module.parts[0] == test.parts[0]]
        if test not in MODULES and test.name not in packages and names.count(test.name) == 1:
            wrong.append(str(test))
    assert wrong == []


def test_folders_of_tests_are_those_of_packages() -> None:
    """No folder of tests is left of a package that is no more."""
    folders = {module.parent for module in MODULES}
    assert {test.parent for test in TESTS if test.parts[0] not in APART} <= folders


@pytest.mark.parametrize("package", sorted({module.parent for module in MODULES} - WITHOUT_TESTS), ids=str)
def test_packages_have_tests(package: PurePosixPath) -> None:
    """Each has a folder of tests, or a file named as it is."""
    of_package = package.with_name(f"test_{package.name}.py")
    assert of_package in TESTS or any(package in test.parents for test in TESTS)
