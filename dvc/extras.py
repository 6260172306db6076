"""Extras of the package: the packages that each command requires besides those of a camera."""

from importlib.util import find_spec

from dvc.errors import DvcError

EXTRAS = {
    "decode": ("jinja2", "pycolmap", "scipy"),
    "stereo": ("jinja2", "matplotlib", "scipy", "skimage"),
    "report": ("jinja2", "matplotlib", "plotly", "pycolmap", "scipy", "skimage"),
}
"""Modules by extra, as `pyproject.toml` has their packages."""


def missing_packages(extra: str) -> list[str]:
    """List the modules of an extra that are not installed."""
    return [name for name in EXTRAS[extra] if find_spec(name) is None]


def check_extra(extra: str) -> None:
    """Refuse to run a command if packages of its extra are missing."""
    missing = missing_packages(extra)
    if missing:
        raise DvcError(f"needs {', '.join(missing)}: pip install 'dvc3d[{extra}]'")
