"""Chapter 5 of the thesis: side information and rate-distortion curves of the codecs with 3D geometry."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dvc.rd.compare import bd_cell, crossing_text
from dvc.rd.curves import Curve, Experiment, experiments
from dvc.rd.points import ANCHORS
from dvc.rd.results import PointResult
from dvc.rd.specification import Sweep
from dvc.rd.tables import NOTHING, escaped, table
from dvc.rd.thesis.chapter import Chapter, Figure, Preset
from dvc.rd.thesis.chapter5_pictures import (
    draw_lossy_keys,
    draw_noise,
    draw_qualities,
    draw_side_information,
)

THESIS_SEQUENCES = ("street", "stairway", "statue")
LOSSLESS_GOP = 10
SEEN_QP = 26
"""QP of the key frames of figure 5.14; the point nearest to it is shown."""
KEYS = (("references", "keys"),)
HIERARCHICAL = (("references", "hierarchical"),)


@dataclass(frozen=True)
class Method:
    """One row of table 5.1.

    Attributes
    ----------
    name : str
        As the thesis calls it.
    codec : str
        Of ours.
    side_information : str or None
        What the decoder is told to predict with; None for the mesh, or block motion in 2D.
    thesis_db : tuple of float
        What the thesis has for its street, stairway and statue.
    """

    name: str
    codec: str
    side_information: str | None
    thesis_db: tuple[float, float, float]

    @property
    def options(self) -> tuple[tuple[str, str], ...]:
        """Options of the encoder: all methods predict from key frames only."""
        return KEYS if self.codec in ("3d-td", "3d-te") else ()

    def made(self, point: PointResult) -> bool:
        """Tell whether a point is of this method, with lossless key frames.

        Parameters
        ----------
        point : PointResult
            Any point.

        Returns
        -------
        bool
            True if it is.
        """
        options = point.data["options"]
        return (
            point.data["codec"] == self.codec
            and point.data["key"].get("lossless") is True
            and options["gop"] == LOSSLESS_GOP
            and options.get("side_information") == self.side_information
            and options["options"] == dict(self.options)
        )


METHODS = (
    Method("2D-DVC (block motion)", "2d", None, (22.3, 19.0, 21.3)),
    Method("3D-DVC (epipolar blocks)", "3d", "blocks", (23.3, 20.0, 22.2)),
    Method("3D-DVC (mesh)", "3d", None, (23.3, 20.1, 22.3)),
    Method("3D-DVC-TD (epipolar blocks)", "3d-td", "blocks", (28.4, 24.7, 25.5)),
    Method("3D-DVC-TD (mesh)", "3d-td", None, (28.9, 25.0, 25.6)),
    Method("3D-DVC-TE (epipolar blocks)", "3d-te", "blocks", (28.6, 28.0, 27.4)),
    Method("3D-DVC-TE (mesh)", "3d-te", None, (29.3, 28.5, 27.6)),
)
"""Rows of table 5.1 of [Maitre2008], with its numbers."""


@dataclass(frozen=True)
class Duel:
    """Two curves of figure 5.15, and what the thesis says of them.

    Attributes
    ----------
    codec, reference : str
        Names in `CURVES`.
    thesis : str
        Where the first is better.
    """

    codec: str
    reference: str
    thesis: str


CURVES: dict[str, Callable[[dict[str, Any]], bool]] = {
    "TE, key frames only": lambda data: _is(data, "3d-te", KEYS),
    "TE, hierarchical": lambda data: _is(data, "3d-te", HIERARCHICAL),
    "TD": lambda data: _is(data, "3d-td", ()),
    "3D without tracks": lambda data: _is(data, "3d", ()),
    "2D-DVC": lambda data: _is(data, "2d", ()),
    "H.264 intra": lambda data: data["codec"] == ANCHORS["intra"],
    "H.264 IPPP, zero motion": lambda data: data["codec"] == ANCHORS["x264-ippp-zero"],
    "H.264 IPPP": lambda data: data["codec"] == ANCHORS["x264-ippp"],
}
"""Curves of figure 5.15, by what tells their points."""

_ALL = "better at all rates"
_ZERO = "better up to 890 kbit/s (street), at all rates (stairway), up to 1400 kbit/s (statue)"
_TD = "better at all rates (street), up to 990 kbit/s (stairway), up to 740 kbit/s (statue)"
DUELS = (
    Duel("TE, key frames only", "2D-DVC", _ALL),
    Duel("TE, key frames only", "H.264 intra", "better"),
    Duel("TE, key frames only", "H.264 IPPP, zero motion", _ZERO),
    Duel("TE, key frames only", "H.264 IPPP", "worse"),
    Duel("TE, hierarchical", "2D-DVC", NOTHING),
    Duel("TE, hierarchical", "H.264 intra", NOTHING),
    Duel("TE, hierarchical", "H.264 IPPP, zero motion", NOTHING),
    Duel("TE, hierarchical", "H.264 IPPP", NOTHING),
    Duel("TD", "2D-DVC", _TD),
    Duel("TD", "H.264 intra", "better"),
    Duel("TD", "3D without tracks", "better"),
)
"""Comparisons that section 5.5.4 of [Maitre2008] makes, and the same for what it does not have."""


def sweeps(preset: Preset, sequences: Sequence[str]) -> list[Sweep]:
    """List the sweeps of the chapter.

    Parameters
    ----------
    preset : Preset
        How much is measured.
    sequences : sequence of str
        Names of the catalogue, or paths.

    Returns
    -------
    list of Sweep
        Curves of figure 5.15, then points with lossless key frames for table 5.1.
    """
    names, frames = tuple(sequences), preset.frames
    first = Sweep(names, "2d", preset.wz_q, frames=frames, anchors=preset.anchors, anchor_qp=preset.anchor_qp)
    curves = [
        Sweep(names, codec, preset.wz_q, gop=gop, frames=frames, options=options)
        for codec, gop, options in (
            ("3d", LOSSLESS_GOP, ()),
            ("3d-td", None, ()),
            ("3d-te", None, KEYS),
            ("3d-te", None, HIERARCHICAL),
        )
    ]
    lossless = [
        Sweep(
            names,
            method.codec,
            (1,),
            ("lossless",),
            LOSSLESS_GOP,
            frames=frames,
            options=method.options,
            side_information=method.side_information,
        )
        for method in METHODS
    ]
    return [first, *curves, *lossless]


def section(results: Sequence[PointResult], folder: Path) -> str:
    """Return the tables of the chapter; its pictures are written beside them.

    Parameters
    ----------
    results : sequence of PointResult
        What was measured.
    folder : Path
        Of the experiment.

    Returns
    -------
    str
        Markdown.
    """
    found = experiments(results)
    parts = ["### Table 5.1: side information from lossless key frames\n", side_information_table(found)]
    parts += ["### Figure 5.15: what the codecs need\n", duels_table(found)]
    parts += ["### Figure 5.13: side information from lossy key frames\n", lossy_table(found)]
    parts.append("### Pictures\n")
    parts += [_pictures(experiment, folder) for experiment in found]
    return "\n".join(parts)


def side_information_table(found: Sequence[Experiment]) -> str:
    """Return table 5.1 beside the numbers of the thesis.

    Parameters
    ----------
    found : sequence of Experiment
        What was measured.

    Returns
    -------
    str
        Markdown.
    """
    note = (
        f"Mean PSNR in dB of the predicted frames, before decoding refines them; key frames lossless and "
        f"{LOSSLESS_GOP} apart, with tracks at the encoder at most that far; predicted from key frames only. "
        "In brackets: the thesis, on its own clips; the rendered scenes of the same names have the "
        "motion of these clips, not their pictures.\n"
    )
    rows = []
    for method in METHODS:
        cells = []
        for experiment in found:
            point = lossless_points(experiment).get(method.name)
            value = None if point is None else point.total("si_psnr_y_db")
            text = NOTHING if value is None else f"{value:.1f}"
            if experiment.name in THESIS_SEQUENCES:
                text += f" ({method.thesis_db[THESIS_SEQUENCES.index(experiment.name)]:.1f})"
            cells.append(text)
        rows.append([method.name, *cells])
    return note + "\n" + table(["method", *(experiment.name for experiment in found)], rows)


def duels_table(found: Sequence[Experiment]) -> str:
    """Return who needs less in figure 5.15, by how much, and up to which rate.

    Parameters
    ----------
    found : sequence of Experiment
        What was measured.

    Returns
    -------
    str
        Markdown.
    """
    rows = []
    for duel in DUELS:
        for experiment in found:
            codec, reference = (_curve(experiment, name) for name in (duel.codec, duel.reference))
            if codec is not None and reference is not None:
                cells = [bd_cell(reference, codec), crossing_text(reference, codec)]
                rows.append([duel.codec, duel.reference, experiment.name, *cells, duel.thesis])
    head = ["codec", "against", "sequence", "BD-rate (overlap, points)", "PSNR at equal rate", "the thesis"]
    return table(head, rows)


def lossy_table(found: Sequence[Experiment]) -> str:
    """Return how the prediction suffers from lossy key frames.

    Parameters
    ----------
    found : sequence of Experiment
        What was measured.

    Returns
    -------
    str
        Markdown; the last row of each sequence has lossless key frames.
    """
    rows = []
    for experiment in found:
        for qp, point in _lossy_points(experiment).items():
            values = (point.total(name) for name in ("key_psnr_y_db", "si_psnr_y_db", "wz_psnr_y_db"))
            rows.append([experiment.name, qp, *(NOTHING if v is None else f"{v:.1f}" for v in values)])
    note = "Tracks at the encoder, mesh, predicted from key frames only; PSNRs in dB.\n"
    return note + "\n" + table(["sequence", "key QP", "key frames", "side information", "decoded"], rows)


def lossless_points(experiment: Experiment) -> dict[str, PointResult]:
    """Find the points of table 5.1.

    Parameters
    ----------
    experiment : Experiment
        What was measured on a sequence.

    Returns
    -------
    dict of str to PointResult
        By name of the method, in the order of the table, as far as they are there.
    """
    points = [point for curve in experiment.curves for point in curve.points]
    made = {method.name: next((p for p in points if method.made(p)), None) for method in METHODS}
    return {name: point for name, point in made.items() if point is not None}


def _lossy_points(experiment: Experiment) -> dict[str, PointResult]:
    """Return the points of figure 5.13 by the QP of their key frames, the coarsest first, lossless last."""
    curve = _curve(experiment, "TE, key frames only")
    points = () if curve is None else curve.points
    found = {str(p.data["key"]["qp"]): p for p in sorted(points, key=lambda p: -p.data["key"]["qp"])}
    lossless = lossless_points(experiment).get(METHODS[-1].name)
    return found if lossless is None else {**found, "lossless": lossless}


def _seen_point(experiment: Experiment) -> PointResult | None:
    """Return the point of figure 5.14."""
    curve = _curve(experiment, "TE, key frames only")
    points = () if curve is None else curve.points
    return min(points, key=lambda point: abs(point.data["key"]["qp"] - SEEN_QP), default=None)


def _curve(experiment: Experiment, name: str) -> Curve | None:
    return next((curve for curve in experiment.curves if CURVES[name](curve.points[0].data)), None)


def _is(data: dict[str, Any], codec: str, options: tuple[tuple[str, str], ...]) -> bool:
    """Tell whether a point belongs to a curve of figure 5.15: lossy key frames, the rest as in `sweeps`."""
    return (
        data["codec"] == codec
        and data["key"].get("lossless") is not True
        and data["options"].get("side_information") is None
        and data["options"]["options"] == dict(options)
    )


def _pictures(experiment: Experiment, folder: Path) -> str:
    """Draw figures 5.11 to 5.14 of a sequence, as far as there is anything to draw."""
    stem = f"thesis-{experiment.slug}"
    methods = lossless_points(experiment)
    drawn = {
        f"Figure 5.11, {experiment.name}: PSNR of predicted frames, lossless key frames": (
            draw_side_information(methods, folder / f"{stem}-5.11")
        ),
        f"Figure 5.12, {experiment.name}: correlation noise": (
            draw_noise(methods, folder, folder / f"{stem}-5.12")
        ),
        f"Figure 5.13, {experiment.name}: PSNR of key frames and of predicted frames, lossy key frames": (
            draw_lossy_keys(tuple(_lossy_points(experiment).values()), folder / f"{stem}-5.13")
        ),
        f"Figure 5.14, {experiment.name}: a key frame, and a frame predicted from it": (
            draw_qualities(_seen_point(experiment), folder, folder / f"{stem}-5.14")
        ),
    }
    return "\n".join(
        f"![{escaped(title)}]({path.name})\n" for title, path in drawn.items() if path is not None
    )


CHAPTER_5 = Chapter(
    "Chapter 5: 3D model-based frame interpolation",
    sweeps,
    (
        Figure(
            "Table 5.1",
            "mean PSNR of predicted frames",
            "[below](#table-51-side-information-from-lossless-key-frames)",
        ),
        Figure("Figure 5.11", "PSNR of every predicted frame, lossless key frames", "[pictures](#pictures)"),
        Figure("Figure 5.12", "correlation noise", "[pictures](#pictures); {page}"),
        Figure(
            "Figure 5.13",
            "PSNR of key and predicted frames, lossy key frames",
            "[table and pictures](#figure-513-side-information-from-lossy-key-frames)",
        ),
        Figure("Figure 5.14", "a key frame and a predicted one", "[pictures](#pictures); {page}"),
        Figure(
            "Figure 5.15",
            "rate-distortion curves",
            "{page}; [who needs less](#figure-515-what-the-codecs-need)",
        ),
    ),
    section,
)
"""What `dvc-rd reproduce thesis` measures and shows of the chapter."""
