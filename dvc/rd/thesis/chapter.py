"""What a chapter of the thesis needs measured, and what it shows of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from dvc.rd.point_result import PointResult
from dvc.rd.specification import Sweep


@dataclass(frozen=True)
class Preset:
    """How much is measured.

    Attributes
    ----------
    frames : int
        Most frames of each sequence.
    wz_q : tuple of int
        Quantiser presets of the rate-distortion curves.
    anchors : tuple of str
        Codecs to compare with, by their names on the command line.
    anchor_qp : tuple of int
        QPs of the anchors beside those of the key frames.
    scenes : tuple of str
        Rendered sequences.
    clips : tuple of str
        Real sequences, of which those are taken that the folder of video files has.
    """

    frames: int
    wz_q: tuple[int, ...]
    anchors: tuple[str, ...]
    anchor_qp: tuple[int, ...]
    scenes: tuple[str, ...]
    clips: tuple[str, ...]


@dataclass(frozen=True)
class Figure:
    """One figure or table of the thesis, and where it is here.

    Attributes
    ----------
    number : str
        Such as ``Figure 5.15``.
    shows : str
        What it shows.
    place : str
        Where to look for it, as Markdown; ``{page}`` stands for a link to the page.
    """

    number: str
    shows: str
    place: str


@dataclass(frozen=True)
class Chapter:
    """What a chapter adds to the reproduction.

    Attributes
    ----------
    title : str
        Its number and name.
    sweeps : callable
        From a preset and the names of sequences to the sweeps that it needs.
    figures : tuple of Figure
        Its figures and tables.
    section : callable
        From results, and a folder for pictures, to its section as Markdown without the title.
    """

    title: str
    sweeps: Callable[[Preset, Sequence[str]], list[Sweep]]
    figures: tuple[Figure, ...]
    section: Callable[[Sequence[PointResult], Path], str]
