"""Entry points of the commands: where another package owns the import name ``dvc``, they say so."""

import importlib
import sys
from importlib.util import find_spec
from pathlib import Path

BAD_INPUT = 2


def foreign_folder() -> str | None:
    """Return the folder of another package that is imported as ``dvc``, or None where it is ours alone."""
    spec = find_spec("dvc")
    folders = [] if spec is None else [Path(folder) for folder in spec.submodule_search_locations or ()]
    # Both packages in one folder overwrite each other; `cli` is a module here and a package there.
    if folders and (folders[0] / "wynerziv").is_dir() and not (folders[0] / "cli").is_dir():
        return None
    return str(folders[0]) if folders else "no folder"


def _start(command: str, module: str) -> int:
    """Run the `main` of a module."""
    folder = foreign_folder()
    if folder is not None:
        sys.stderr.write(
            f"{command}: `dvc` is imported from {folder}, which is another package (Data Version Control has "
            "this import name, too); install dvc3d into an environment of its own\n"
        )
        return BAD_INPUT
    status: int = importlib.import_module(module).main()
    return status


def encode() -> int:
    """Run ``dvc-encode``."""
    return _start("dvc-encode", "encoder.__main__")


def decode() -> int:
    """Run ``dvc-decode``."""
    return _start("dvc-decode", "decoder.__main__")


def compile_kernels() -> int:
    """Run ``dvc-compile``."""
    return _start("dvc-compile", "dvc.compile_kernels")


def dibr() -> int:
    """Run ``dvc-dibr``."""
    return _start("dvc-dibr", "dvc.dibr.__main__")


def rd() -> int:
    """Run ``dvc-rd``."""
    return _start("dvc-rd", "dvc.rd.__main__")


def sequences() -> int:
    """Run ``dvc-sequences``."""
    return _start("dvc-sequences", "sequences.__main__")


def sfm() -> int:
    """Run ``dvc-sfm``."""
    return _start("dvc-sfm", "sfm.__main__")


def stereo() -> int:
    """Run ``dvc-stereo``."""
    return _start("dvc-stereo", "dvc.stereo.__main__")
