"""Versions of all packages that the results were measured with, as constraints for pip."""

import re
from importlib import metadata
from pathlib import Path

from benchmarks.results.code import ROOT
from dvc.files import atomic_output

CONSTRAINTS = ROOT / "docs" / "constraints.txt"
_HEAD = "# What results were measured with: pip install -c docs/constraints.txt '.[all]', by make results\n"
_NAME = re.compile(r"[A-Za-z0-9._-]+")
_FOR_DEVELOPERS = re.compile(r"extra == ['\"](docs|test|check)['\"]")


def constraints_text() -> str:
    """Return a line for each installed package that this one needs, directly or not."""
    found, names = dict[str, str](), ["dvc3d"]
    while names:
        name = names.pop()
        for needed in metadata.requires(name) or ():
            is_extra = "extra ==" in needed and (name != "dvc3d" or _FOR_DEVELOPERS.search(needed))
            match = _NAME.match(needed)
            if is_extra or match is None or (key := re.sub(r"[-_.]+", "-", match[0]).lower()) in found:
                continue
            try:
                found[key] = metadata.version(key)
            except metadata.PackageNotFoundError:  # a package for other systems
                continue
            names.append(key)
    found.pop("dvc3d", None)
    return _HEAD + "".join(f"{name}=={version}\n" for name, version in sorted(found.items()))


def write_constraints(path: Path = CONSTRAINTS) -> None:
    """Write the constraints."""
    with atomic_output(path) as temporary:
        temporary.write_text(constraints_text(), encoding="utf-8")
