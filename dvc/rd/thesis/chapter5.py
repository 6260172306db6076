"""Chapter 5 of the thesis: side information and rate-distortion curves of the codecs with 3D geometry."""

from collections.abc import Sequence
from pathlib import Path

from dvc.rd.curves import Experiment, experiments
from dvc.rd.differences import bd_text, compare_curves, crossing_text
from dvc.rd.point_result import PointResult
from dvc.rd.specification import Sweep
from dvc.rd.tables import NOTHING, escaped, table
from dvc.rd.thesis.chapter import Chapter, Figure, Preset
from dvc.rd.thesis.chapter5_curves import (
    DUELS,
    HIERARCHICAL,
    KEYS,
    LOSSLESS_GOP,
    METHODS,
    THESIS_SEQUENCES,
    find_curve,
    find_points,
)
from dvc.rd.thesis.chapter5_pictures import draw_pictures


def _sweeps(preset: Preset, sequences: Sequence[str]) -> list[Sweep]:
    """List the _sweeps: curves of figure 5.15, then points with lossless key frames for table 5.1."""
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


def _section(results: Sequence[PointResult], folder: Path) -> str:
    """Return the tables of the chapter; its pictures are written beside them."""
    found = experiments(results)
    parts = ["### Table 5.1: side information from lossless key frames\n", _side_information_table(found)]
    parts += ["### Figure 5.15: what the codecs need\n", _duels_table(found)]
    parts += ["### Figure 5.13: side information from lossy key frames\n", _lossy_table(found)]
    parts.append("### Pictures\n")
    parts += [_pictures(experiment, folder) for experiment in found]
    return "\n".join(parts)


def _side_information_table(found: Sequence[Experiment]) -> str:
    """Return table 5.1 beside the numbers of the thesis."""
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
            point = find_points(experiment).lossless.get(method.name)
            value = None if point is None else point.total("si_psnr_y_db")
            text = NOTHING if value is None else f"{value:.1f}"
            if method.thesis_db is not None and experiment.name in THESIS_SEQUENCES:
                text += f" ({method.thesis_db[THESIS_SEQUENCES.index(experiment.name)]:.1f})"
            cells.append(text)
        rows.append([method.name, *cells])
    return note + "\n" + table(["method", *(experiment.name for experiment in found)], rows)


def _duels_table(found: Sequence[Experiment]) -> str:
    """Return who needs less in figure 5.15, by how much, and up to which rate."""
    rows = []
    for duel in DUELS:
        for experiment in found:
            codec, reference = (find_curve(experiment, name) for name in (duel.codec, duel.reference))
            if codec is not None and reference is not None:
                cells = [bd_text(compare_curves(reference, codec)), crossing_text(reference, codec)]
                rows.append([duel.codec, duel.reference, experiment.name, *cells, duel.thesis])
    head = ["codec", "against", "sequence", "BD-rate (overlap, points)", "PSNR at equal rate", "the thesis"]
    return table(head, rows)


def _lossy_table(found: Sequence[Experiment]) -> str:
    """Return how the prediction suffers from lossy key frames; the last row of each sequence is lossless."""
    rows = []
    for experiment in found:
        for qp, point in find_points(experiment).lossy.items():
            values = (point.total(name) for name in ("key_psnr_y_db", "si_psnr_y_db", "wz_psnr_y_db"))
            rows.append([experiment.name, qp, *(NOTHING if v is None else f"{v:.1f}" for v in values)])
    note = "Tracks at the encoder, dense depth, predicted from key frames only; PSNRs in dB.\n"
    return note + "\n" + table(["sequence", "key QP", "key frames", "side information", "decoded"], rows)


def _pictures(experiment: Experiment, folder: Path) -> str:
    """Draw figures 5.11 to 5.14 of a sequence, as far as there is anything to draw."""
    pictures = draw_pictures(find_points(experiment), folder, f"thesis-{experiment.slug}")
    return "\n".join(
        f"![{escaped(f'Figure {number}, {experiment.name}: {_TITLES[number]}')}]({name})\n"
        for number, name in pictures.items()
    )


_TITLES = {
    "5.11": "PSNR of predicted frames, lossless key frames",
    "5.12": "correlation noise",
    "5.13": "PSNR of key frames and of predicted frames, lossy key frames",
    "5.14": "a key frame, and a frame predicted from it",
}
CHAPTER_5 = Chapter(
    "Chapter 5: 3D model-based frame interpolation",
    _sweeps,
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
    _section,
)
"""What `dvc-rd reproduce thesis` measures and shows of the chapter."""
