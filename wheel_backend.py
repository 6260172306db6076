"""Build backend: setuptools, and kernels in the wheel, compiled for the Python and the numba that build it.

They lie beside their sources, where programs look first. Under another numba, the first use compiles them.
"""

import os
import shutil
import subprocess
import sysconfig
import tomllib
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403
from setuptools.command.build_py import build_py

from dvc.compile_kernels import listed
from dvc.environment import child_environment, python_module
from dvc.extras import EXTRAS


class CompiledPackages(build_py):  # type: ignore[misc]
    """Copies the packages, and compiles what programs call; an editable install is left as it is."""

    def run(self) -> None:
        """Build."""
        if self.editable_mode:
            super().run()
            return
        shutil.rmtree(self.build_lib, ignore_errors=True)  # what is no more is not shipped
        super().run()
        packages, environment = Path(self.build_lib).resolve(), child_environment()
        environment = {name: value for name, value in environment.items() if not name.startswith("NUMBA_")}
        environment["PYTHONPATH"] = f"{packages}{os.pathsep}{environment['PYTHONPATH']}"
        subprocess.run(python_module("dvc.compile_kernels"), env=environment, check=True)
        _prune(packages)


def _prune(root: Path) -> None:
    """Keep what is listed: what these kernels call is part of them."""
    called = {(kernel.module, kernel.name) for kernel in listed()}
    for path in root.rglob("__pycache__/*"):
        file, _, name = path.name.partition("-")[0].partition(".")
        module = ".".join([*path.relative_to(root).parts[:-2], file])
        if (module, name) not in called:
            path.unlink()


def get_requires_for_build_wheel(config_settings: dict[str, Any] | None = None) -> list[str]:
    """Add what the packages import, those of all commands."""
    project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
    of_extras = (name for extra in EXTRAS for name in project["optional-dependencies"][extra])
    imported = dict.fromkeys((*project["dependencies"], *of_extras))
    return [*build_meta.get_requires_for_build_wheel(config_settings), *imported]


def build_wheel(
    wheel_directory: str,
    config_settings: dict[str, Any] | None = None,
    metadata_directory: str | None = None,
) -> str:
    """Name the wheel by the Python and the machine that its kernels are for."""
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    tags = [f"--python-tag=cp{sysconfig.get_config_var('py_version_nodot')}", f"--plat-name={platform}"]
    settings = {**(config_settings or {}), "--build-option": tags}
    name: str = build_meta.build_wheel(wheel_directory, settings, metadata_directory)
    return name
