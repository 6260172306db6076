"""Figures 2.2 and 2.8: the rendered array of two by two cameras, whose axes are not parallel."""

import tempfile
from pathlib import Path

from dvc.environment import python_module
from dvc.rd.child_processes import ProcessGroup
from dvc.stereo.rectification.rectified_array import RectifiedArray, rectified_array


def rectified_toy() -> RectifiedArray:
    """Render the views in a process of its own, and rectify them by their cameras."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "toy"
        ProcessGroup().run(python_module("sequences", "render", "toy", "--out", folder))
        return rectified_array(sorted(folder.glob("toy-*.png")), folder / "cameras.json")
