"""What commands need beyond what a camera does: extras of the package, and the line that they are missing."""

from importlib.util import find_spec

from dvc.errors import DvcError

EXTRAS = {
    "decode": ("jinja2", "pycolmap", "scipy"),
    "stereo": ("jinja2", "matplotlib", "scipy", "skimage"),
    "report": ("jinja2", "matplotlib", "plotly", "pycolmap", "scipy", "skimage"),
}
"""Modules by extra, as `pyproject.toml` has their packages."""


def check_extra(extra: str) -> None:
    """Refuse to go on where modules of an extra are missing."""
    missing = [name for name in EXTRAS[extra] if find_spec(name) is None]
    if missing:
        raise DvcError(f"needs {', '.join(missing)}: pip install 'dvc3d[{extra}]'")


def of_an_extra(module: str | None) -> bool:
    """Tell whether a module comes with an extra alone."""
    return module is not None and any(module.split(".")[0] in modules for modules in EXTRAS.values())
