"""What a chapter of the thesis needs measured, and what it shows of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from dvc.rd.point_result import PointResult
from dvc.rd.specification import Sweep


@dataclass(frozen=True)
class Preset:
    """How much is measured."""

    frames: int  # most frames of each sequence
    wz_q: tuple[int, ...]  # quantiser presets of the rate-distortion curves
    anchors: tuple[str, ...]  # codecs to compare with, by their names on the command line
    anchor_qp: tuple[int, ...]  # QPs of the anchors beside those of the key frames
    scenes: tuple[str, ...]  # rendered sequences
    clips: tuple[str, ...]  # real sequences, of which those are taken that the folder of video files has


@dataclass(frozen=True)
class Figure:
    """One figure or table of the thesis, and where it is here."""

    number: str  # such as ``Figure 5.15``
    shows: str  # what it shows
    place: str  # where to look for it, as Markdown; ``{page}`` stands for a link to the page


@dataclass(frozen=True)
class Chapter:
    """What a chapter adds to the reproduction."""

    title: str  # its number and name
    # from a preset and the names of sequences to the sweeps that it needs
    sweeps: Callable[[Preset, Sequence[str]], list[Sweep]]
    figures: tuple[Figure, ...]  # its figures and tables
    # from results, and a folder for pictures, to its section as Markdown without the title
    section: Callable[[Sequence[PointResult], Path], str]
