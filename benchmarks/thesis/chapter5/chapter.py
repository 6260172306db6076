"""Chapter 5 of the thesis: side information and rate-distortion curves of the codecs with 3D geometry."""

from collections.abc import Mapping, Sequence
from functools import partial

from benchmarks.thesis.chapter import Chapter, Figure, Made, Step, Task, Value, Way
from benchmarks.thesis.chapter5 import pictures
from benchmarks.thesis.chapter5.correspondences import correspondences
from benchmarks.thesis.chapter5.curves import (
    CODECS,
    DUELS,
    FULL,
    LOSSLESS_GOP,
    METHODS,
    OURS_METHODS,
    QUICK,
    SEEN_QP,
    THESIS_SEQUENCES,
    sweeps,
)
from dvc.errors import DvcError
from dvc.rd.child_processes import ProcessGroup
from dvc.rd.comparison import bd_rate_text
from dvc.rd.originals import available_clips, check_source, default_cache, source_name
from dvc.rd.rd_curves import Curve, compare_curves, crossing_text
from dvc.rd.rd_results import PointResult, options_of, read_results
from dvc.rd.run_points import run_points
from dvc.rd.specification import Point
from dvc.web.plotting import Line, line_plot

SIDE_INFORMATION, CURVES, SEEN, TEXT = "Table 5.1", "Figure 5.15", "Figure 5.14", "Sections 5.5.2 and 5.5.3"
PREDICTED = "{}: {} [dB]"
AGAINST = "{}: {} against {}"
KEY_FRAME, PREDICTED_FRAME = "{}: key frame, QP near 26 [dB]", "{}: frame predicted from it [dB]"
TRACKS = "{}: tracks of {} [bpp]"


def _frames(task: Task) -> int:
    return task.frames or (FULL if task.full else QUICK).frames


def _measured(points: Sequence[Point], task: Task, made: Made) -> dict[Point, PointResult]:
    """Measure points, or find them measured; note what has failed."""
    summary = run_points(points, task.folder, default_cache(), jobs=task.jobs, cluster=task.cluster)
    made.failures += [f"{name}: {why}" for name, why in summary.failures]
    if len(summary.failures) == len(points):
        return {}
    sequence = points[0].sequence
    original = source_name(sequence), summary.digests[sequence]
    by_options = {
        str(result.options): result
        for result in read_results(task.folder)
        if (result.sequence.name, result.sequence.digest) == original
    }
    found = {point: by_options.get(str(options_of(point))) for point in points}
    return {point: result for point, result in found.items() if result is not None}


def _side_information(sequence: str, task: Task, way: Way) -> Made:
    """Table 5.1, figures 5.11 and 5.12: predictions from lossless key frames."""
    methods, made = METHODS if way is Way.THESIS else OURS_METHODS, Made()
    points = {method.point(sequence, _frames(task), way): method.name for method in methods}
    found = _measured(list(points), task, made)
    by_name = {points[point]: result for point, result in found.items()}
    name = source_name(sequence)
    for method, result in by_name.items():
        value = result.totals.si_psnr_y_db
        made.values.append(Value(SIDE_INFORMATION, PREDICTED.format(name, method), value or "none", ".1f"))
    lines = [(method, pictures.predicted(result)) for method, result in by_name.items()]
    made.plots["5.11", name] = _frames_plot(lines, f"{name}: predicted frames")
    if (noise := pictures.noise(by_name, task.folder)) is not None:
        made.pictures["5.12", name] = noise
    return made


def _frames_plot(lines: Sequence[tuple[str, Mapping[int, float]]], title: str) -> dict[str, bytes]:
    drawn = [Line(name, sorted(psnrs), [psnrs[index] for index in sorted(psnrs)]) for name, psnrs in lines]
    return line_plot(drawn, title, "frame", "luma PSNR [dB]")


def _curves(sequence: str, task: Task, way: Way) -> Made:
    """Figures 5.13 to 5.15: rates, and predictions from lossy key frames."""
    preset, made = FULL if task.full else QUICK, Made()
    planned = sweeps(sequence, preset, _frames(task), way)
    found = _measured(list(dict.fromkeys(p for points in planned.values() for p in points)), task, made)
    name, curves = source_name(sequence), {}
    for label, points in planned.items():
        results = sorted((found[point] for point in points if point in found), key=lambda one: one.rate_kbps)
        if results:
            curves[label] = Curve(label, label not in CODECS, tuple(results))
    for duel in DUELS:
        if duel.codec in curves and duel.reference in curves:
            told = _outcome(curves[duel.reference], curves[duel.codec])
            made.values.append(Value(CURVES, AGAINST.format(name, duel.codec, duel.reference), told))
    lines = [Line(label, curve.rates_kbps, curve.psnrs_y_db) for label, curve in curves.items()]
    made.plots["5.15", name] = line_plot(lines, name, "rate [kbit/s]", "luma PSNR [dB]")
    for codec in ("3D-DVC-TD", "3D-DVC-TE"):
        if codec in curves:
            rates = [pictures.tracks_bpp(point) for point in curves[codec].points]
            made.values.append(Value(TEXT, TRACKS.format(name, codec), max(rates), ".4f"))
    if "3D-DVC-TE" in curves:
        _lossy(name, curves["3D-DVC-TE"].points, task, made)
    return made


def _outcome(reference: Curve, codec: Curve) -> str:
    return f"{crossing_text(reference, codec)}; {bd_rate_text(compare_curves(reference, codec))}"


def _lossy(name: str, points: Sequence[PointResult], task: Task, made: Made) -> None:
    """Figures 5.13 and 5.14: key frames and predictions of one codec by QP."""
    lines = [
        (f"QP {point.key.qp}", {**pictures.predicted(point), **pictures.keys(point)}) for point in points
    ]
    made.plots["5.13", name] = _frames_plot(lines, f"{name}: key and predicted frames")
    seen = min(points, key=lambda point: abs((point.key.qp or 0) - SEEN_QP))
    for text, psnr_db in zip((KEY_FRAME, PREDICTED_FRAME), pictures.seen_db(seen), strict=True):
        if psnr_db is not None:
            made.values.append(Value(SEEN, text.format(name), psnr_db, ".1f"))
    if (panels := pictures.quality(seen, task.folder)) is not None:
        made.pictures["5.14", name] = panels


def _correspondences(sequence: str, task: Task, way: Way) -> Made:
    """Figures 5.3 and 5.10."""
    del way
    name = source_name(sequence)
    apart = LOSSLESS_GOP if task.frames is None else min(LOSSLESS_GOP, task.frames - 1)
    try:
        lossless, coarse = correspondences(sequence, apart).values()
    except DvcError as err:
        return Made(failures=[f"{name}: {err}"])
    return Made(pictures={("5.3", name): lossless, ("5.10", name): coarse})


def _steps(task: Task) -> list[Step]:
    preset = FULL if task.full else QUICK
    sequences = task.chosen
    for sequence in sequences:
        check_source(sequence, ProcessGroup())
    if not sequences:
        available = available_clips(ProcessGroup())
        sequences = (*preset.scenes, *(name for name in preset.clips if name in available))
    steps = []
    for sequence in sequences:
        name = source_name(sequence)
        steps += [
            Step(f"correspondences-{name}", partial(_correspondences, sequence), (Way.THESIS,)),
            Step(f"side-information-{name}", partial(_side_information, sequence)),
            Step(f"curves-{name}", partial(_curves, sequence)),
        ]
    return steps


def _printed() -> dict[tuple[str, str], str]:
    printed = {
        (SIDE_INFORMATION, PREDICTED.format(sequence, method.name)): f"{method.thesis_db[index]:.1f}"
        for index, sequence in enumerate(THESIS_SEQUENCES)
        for method in METHODS
    }
    for duel in DUELS:
        printed |= {
            (CURVES, AGAINST.format(sequence, duel.codec, duel.reference)): text
            for sequence, text in duel.printed.items()
        }
    printed[SEEN, KEY_FRAME.format("street")] = "36.5"
    printed[SEEN, PREDICTED_FRAME.format("street")] = "28.4"
    for sequence in THESIS_SEQUENCES:
        printed[TEXT, TRACKS.format(sequence, "3D-DVC-TD")] = "0.02"
        printed[TEXT, TRACKS.format(sequence, "3D-DVC-TE")] = "less than 0.01"
    return printed


_DIAGRAM = "a diagram of the method"
_CLIPS = "the clips of the thesis are not public; rendered scenes with their motion instead"
CHAPTER = Chapter(
    5,
    "3D model-based frame interpolation",
    _printed(),
    (
        Figure("5.1", "outline of the codec", _DIAGRAM),
        Figure("5.2", "outline of the construction of models", _DIAGRAM),
        Figure("5.3", "correspondences and epipolar geometry", _CLIPS),
        Figure("5.4", "trifocal transfer", _DIAGRAM),
        Figure("5.5", "outline of interpolation by epipolar blocks", _DIAGRAM),
        Figure("5.6", "outline of interpolation by meshes", _DIAGRAM),
        Figure(
            "5.7",
            "norm of the motion vectors",
            "no command tells motion; `python -m benchmarks.pictures.scene` draws it",
        ),
        Figure("5.8", "outline of tracking at the decoder", _DIAGRAM),
        Figure("5.9", "outline of tracking at the encoder", _DIAGRAM),
        Figure("5.10", "the same from coarse key frames", _CLIPS),
        Figure("5.11", "PSNR of every predicted frame", _CLIPS),
        Figure("5.12", "correlation noise", _CLIPS),
        Figure("5.13", "PSNR of key and predicted frames by QP", _CLIPS),
        Figure("5.14", "a key frame, and one that is predicted from it", _CLIPS),
        Figure("5.15", "rate-distortion curves", _CLIPS),
    ),
    (
        "The clips are not public. Rendered scenes of the same names have their motion, not their pictures.",
        "The Wyner-Ziv codec is not described: that of its family, with DISCOVER matrices and their "
        "QPs, punctured "
        "turbo codes, and noise of every coefficient.",
        "GOPs as written: 2 in 2D, 10 in 3D and with tracks at the decoder, by the tracks at the "
        "encoder; predicted "
        "from key frames alone. Table 5.1: 10, and at most 10 by the tracks.",
        "Table 5.1: ours predict from dense depth, which stands beside the mesh. Curves: ours have "
        "their defaults.",
        "As written, the linear program of self-calibration has no slack and no unit but that of the "
        "fundamental "
        "matrix, and bundle adjustment alternates alone, 100 times at most (`--sfm thesis`); ours drop "
        "points that "
        "stand in the way and finish with joint steps.",
        "The reference software of H.264 is that of x264 here. The thesis has 50 frames of each sequence.",
    ),
    _steps,
)
