"""Cells of shell commands: `%%sh` stops at the first that fails, and shows what all have written."""

import subprocess

from IPython.core.magic import register_cell_magic


@register_cell_magic
def sh(line: str, cell: str) -> None:
    """Run the commands of a cell."""
    command = ["bash", "-euo", "pipefail", *line.split()]
    done = subprocess.run(
        command, input=cell, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False
    )
    print(done.stdout, end="")  # noqa: T201
    done.check_returncode()
