"""Entry point of all commands: if another package owns the import name ``dvc``, it says so."""

import importlib
import sys
from importlib.util import find_spec
from pathlib import Path

BAD_INPUT = 2
MODULES = {
    "dvc-compile": "dvc.compile_kernels",
    "dvc-decode": "decoder.__main__",
    "dvc-dibr": "dvc.dibr.__main__",
    "dvc-encode": "encoder.__main__",
    "dvc-rd": "dvc.rd.__main__",
    "dvc-sequences": "sequences.__main__",
    "dvc-sfm": "sfm.__main__",
    "dvc-stereo": "dvc.stereo.__main__",
}
"""Modules of the commands."""


def foreign_folder() -> str | None:
    """Return the folder of another package that is imported as ``dvc``, or None if it is ours only."""
    spec = find_spec("dvc")
    folders = [] if spec is None else [Path(folder) for folder in spec.submodule_search_locations or ()]
    # Both packages in one folder overwrite each other; `cli` is a module here and a package there.
    if folders and (folders[0] / "wynerziv").is_dir() and not (folders[0] / "cli").is_dir():
        return None
    return str(folders[0]) if folders else "no folder"


def main() -> int:
    """Run the command that the script is named after."""
    command = Path(sys.argv[0]).stem
    folder = foreign_folder()
    if folder is not None:
        sys.stderr.write(
            f"{command}: `dvc` is imported from {folder}, which is another package (Data Version Control has "
            "this import name, too); install dvc3d into an environment of its own\n"
        )
        return BAD_INPUT
    status: int = importlib.import_module(MODULES[command]).main()
    return status
