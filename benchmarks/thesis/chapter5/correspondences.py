"""Figures 5.3 and 5.10: correspondences and epipolar geometry between the first two key frames."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.thesis.chapter5.curves import LOSSLESS_GOP
from dvc.environment import python_module
from dvc.errors import DvcError
from dvc.rd.child_processes import ProcessGroup
from dvc.rd.originals import default_cache, find_source
from dvc.web.drawing import Picture

COARSE_QP = 42
"""Of the quantised key frames of figure 5.10."""


def correspondences(sequence: str, apart: int = LOSSLESS_GOP) -> dict[str, Picture]:
    """Draw them for lossless and for coarse key frames, each by processes of their own."""
    processes = ProcessGroup()
    original = find_source(sequence, default_cache(), processes).path
    with tempfile.TemporaryDirectory() as scratch:
        stream, decoded = Path(scratch) / "coarse.dvc", Path(scratch) / "coarse.mkv"
        coding = ["--codec", "2d", "--gop", "1", "--key-qp", str(COARSE_QP)]
        _run(processes, "encoder", [str(original), str(stream), *coding, "--frames", str(apart + 1)])
        _run(processes, "decoder", [str(stream), str(decoded)])
        return {
            name: _drawn(processes, video, apart, Path(scratch) / name.replace(" ", "-"))
            for name, video in (("lossless", original), (f"QP {COARSE_QP}", decoded))
        }


def _run(processes: ProcessGroup, program: str, words: Sequence[str]) -> None:
    processes.run(python_module(program, *words, "--quiet"))


def _drawn(processes: ProcessGroup, video: Path, apart: int, folder: Path) -> Picture:
    how = ["--frames", "0", str(apart), "--sfm", "thesis", "--out", str(folder)]
    _run(processes, "sfm", [str(video), str(video), *how])
    drawn = folder / "correspondences.png"
    if not drawn.is_file():
        raise DvcError("dvc-sfm finds no depth between the key frames")
    return np.asarray(cv2.imread(str(drawn), cv2.IMREAD_COLOR), np.uint8)
