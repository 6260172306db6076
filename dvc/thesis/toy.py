"""Figures 2.2 and 2.8: the rendered array of two by two cameras, whose axes are not parallel."""

import subprocess
import sys
import tempfile
from pathlib import Path

from dvc.errors import DvcError
from dvc.stereo.rectification.rectified_array import RectifiedArray, rectified_array


def rectified_toy() -> RectifiedArray:
    """Render the views in a process of its own, and rectify them by their cameras."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "toy"
        command = [sys.executable, "-m", "sequences", "render", "toy", "--out", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise DvcError(f"cannot render toy: {done.stderr.strip()[-200:]}")
        return rectified_array(sorted(folder.glob("toy-*.png")), folder / "cameras.json")
