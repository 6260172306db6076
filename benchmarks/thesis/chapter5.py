"""Chapter 5 of the thesis: side information and rate-distortion curves of the codecs with 3D geometry."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.thesis.harness import Method, Step, StepResult, Task, Value, load_chapter
from dvc.environment import python_module
from dvc.errors import DvcError
from dvc.rd.child_processes import ProcessGroup
from dvc.rd.comparison import bd_rate_text
from dvc.rd.originals import catalogue, default_cache, find_source, source_name
from dvc.rd.rd_curves import Curve, compare_curves, crossing_text
from dvc.rd.rd_page import read_picture
from dvc.rd.rd_results import PictureFiles, PointResult, options_of, read_results
from dvc.rd.run_points import run_points
from dvc.rd.specification import Point, Sweep
from dvc.web.drawing import Picture, in_rows, with_title
from dvc.web.plotting import Line, line_plot

SCENES = ("street", "stairway", "statue")
LOSSLESS_GOP = 10
SEEN_QP, COARSE_QP = 26, 42
"""QPs of the key frames of figures 5.14 (the nearest point) and 5.10."""
NOISE_GAIN = 4
"""Gain of differences in figure 5.12."""
Options = tuple[tuple[str, str], ...]
KEYS: Options = (("references", "keys"),)
TURBO: Options = (("coder", "turbo"), ("noise-model", "coefficient"))
"""Classical turbo codes with punctured parity, and the noise of each coefficient by that of its band."""
CAMERAS: Options = (("sfm", "thesis"),)
"""Options of the decoder: self-calibration and bundle adjustment to the letter."""
SIDE_INFORMATION, CURVES, SEEN, TEXT = "Table 5.1", "Figure 5.15", "Figure 5.14", "Sections 5.5.2 and 5.5.3"
PREDICTED, AGAINST, TRACKS = "{}: {} [dB]", "{}: {} against {}", "{}: tracks of {} [bpp]"
KEY_FRAME, PREDICTED_FRAME = "{}: key frame, QP near 26 [dB]", "{}: frame predicted from it [dB]"


@dataclass(frozen=True)
class Preset:
    """Extent of the measurements."""

    frames: int  # largest number of frames of each sequence
    wz_q: tuple[int, ...]  # DISCOVER matrices of the curves as written
    qp: tuple[int, ...]  # qualities of ours
    anchor_qp: tuple[int, ...]  # QPs of the anchors
    scenes: tuple[str, ...]  # rendered sequences
    clips: tuple[str, ...]  # real sequences, if the folder of video files has them


QUICK = Preset(9, (1, 4, 7), (22, 30, 38), (20, 28, 36, 44), ("street",), ("box",))
FULL = Preset(
    17,  # the longest group of pictures: hours already; the thesis has 50 frames
    (1, 2, 4, 6, 8),
    (22, 26, 30, 34, 38),
    tuple(range(20, 45, 4)),
    SCENES,
    ("box", "desk", "river", "stone", "tree"),
)


class Prediction(NamedTuple):
    """A row of table 5.1 of [Maitre2008]."""

    name: str
    codec: str
    side_information: str | None  # method of the decoder; None for block motion


PREDICTIONS = (
    Prediction("2D-DVC (classical block matching)", "2d", None),
    Prediction("3D-DVC (epipolar blocks)", "3d", "blocks"),
    Prediction("3D-DVC (mesh)", "3d", "mesh"),
    Prediction("3D-DVC-TD (epipolar blocks)", "3d-td", "blocks"),
    Prediction("3D-DVC-TD (mesh)", "3d-td", "mesh"),
    Prediction("3D-DVC-TE (epipolar blocks)", "3d-te", "blocks"),
    Prediction("3D-DVC-TE (mesh)", "3d-te", "mesh"),
)
ROWS = {
    Method.THESIS: PREDICTIONS,
    Method.DEFAULT: tuple(row for row in PREDICTIONS if row.side_information != "blocks"),
}
"""Rows that are measured: ours predict from dense depth, one row for each codec."""
CODECS = {"2D-DVC": "2d", "3D-DVC": "3d", "3D-DVC-TD": "3d-td", "3D-DVC-TE": "3d-te"}
TRACKED = "3d-td", "3d-te"
ANCHORS = {"H.264 intra": "intra", "H.264 IPPP": "x264-ippp"}
"""Codecs of figure 5.15 by their names in it."""


COMPARISONS = (
    ("3D-DVC-TE", "2D-DVC"),
    ("3D-DVC-TD", "2D-DVC"),
    ("3D-DVC-TE", "3D-DVC"),
    ("3D-DVC-TD", "3D-DVC"),
    ("3D-DVC-TE", "H.264 intra"),
    ("3D-DVC-TD", "H.264 intra"),
    ("3D-DVC-TE", "H.264 IPPP"),
)
"""Curves of figure 5.15 that section 5.5.4 of [Maitre2008] compares, each with its reference."""


def prediction_point(row: Prediction, sequence: str, frames: int, method: Method) -> Point:
    """Return the point that measures a row of table 5.1: predicted only from lossless key frames."""
    side_information = row.side_information if method is Method.THESIS else None
    sweep = Sweep(
        (sequence,),
        row.codec,
        (1,),
        ("lossless",),
        LOSSLESS_GOP,
        frames=frames,
        luma_only=True,
        options=KEYS if row.codec in TRACKED else (),
        side_information=side_information,
    )
    return _with_cameras(next(sweep.points()), method)


def _with_cameras(point: Point, method: Method) -> Point:
    """Add the decoder's option for cameras as written if the method is that of the thesis."""
    has_cameras = method is Method.THESIS and point.side_information is not None
    return replace(point, decoder=CAMERAS) if has_cameras else point


def curve_points(sequence: str, preset: Preset, frames: int, method: Method) -> dict[str, list[Point]]:
    """Return the points of the curves of figure 5.15 by name."""
    curves = {}
    for name, codec in CODECS.items():
        if method is Method.DEFAULT:
            sweep = Sweep((sequence,), codec, frames=frames, luma_only=True, qp=preset.qp)
        else:
            sweep = Sweep(
                (sequence,),
                codec,
                preset.wz_q,
                gop=LOSSLESS_GOP if codec in ("3d", "3d-td") else None,
                frames=frames,
                luma_only=True,
                options=tuple(sorted(TURBO + (KEYS if codec in TRACKED else ()))),
                side_information=None if codec == "2d" else "mesh",
            )
        curves[name] = [_with_cameras(point, method) for point in sweep.points()]
    for name, anchor in ANCHORS.items():
        sweep = Sweep(
            (sequence,),
            "2d",
            preset.wz_q,
            gop=1,
            frames=frames,
            luma_only=True,
            anchors=(anchor,),
            anchor_qp=preset.anchor_qp,
        )
        curves[name] = [point for point in sweep.points() if not point.has_wyner_ziv and point.codec != "2d"]
    return curves


def _preset(task: Task) -> Preset:
    preset = FULL if task.full else QUICK
    return replace(preset, frames=task.frames or preset.frames)


def _measured(points: Sequence[Point], task: Task, result: StepResult) -> dict[Point, PointResult]:
    """Measure points that have no result yet, and note failures."""
    summary = run_points(points, task.folder, default_cache(), jobs=task.jobs, cluster=task.cluster)
    result.failures += [f"{name}: {why}" for name, why in summary.failures]
    if len(summary.failures) == len(points):
        return {}
    sequence = points[0].sequence
    original = source_name(sequence), summary.digests[sequence]
    by_options = {
        str(one.options): one
        for one in read_results(task.folder)
        if (one.sequence.name, one.sequence.digest) == original
    }
    results = {point: by_options.get(str(options_of(point))) for point in points}
    return {point: one for point, one in results.items() if one is not None}


def _predicted_db(point: PointResult) -> dict[int, float]:
    """Return the PSNR of each predicted frame by its number."""
    return {
        frame.index or 0: frame.si_psnr_y_db for frame in point.per_frame if frame.si_psnr_y_db is not None
    }


def _keys_db(point: PointResult) -> dict[int, float]:
    """Return the PSNR of each key frame by its number."""
    return {frame.index or 0: frame.psnr_y_db or 0.0 for frame in point.per_frame if frame.type == "key"}


def _planes(point: PointResult, folder: Path, names: Sequence[str]) -> list[NDArray[np.int16]] | None:
    """Return pictures of a point, if all of them exist in one size."""
    pictures, planes = point.pictures or PictureFiles(), []
    for name in names:
        path = getattr(pictures, name, None)
        plane = read_picture(folder / path) if isinstance(path, str) else None
        if plane is None:
            return None
        planes.append(np.asarray(plane, dtype=np.int16))
    return planes if len({plane.shape for plane in planes}) == 1 else None


def _frames_plot(lines: Sequence[tuple[str, Mapping[int, float]]], title: str) -> dict[str, bytes]:
    drawn = [Line(name, sorted(psnrs), [psnrs[index] for index in sorted(psnrs)]) for name, psnrs in lines]
    return line_plot(drawn, title, "frame", "luma PSNR [dB]")


def _side_information(sequence: str, task: Task, method: Method) -> StepResult:
    """Measure table 5.1 and figures 5.11 and 5.12: predictions from lossless key frames."""
    result, name, frames = StepResult(), source_name(sequence), _preset(task).frames
    rows = {prediction_point(row, sequence, frames, method): row.name for row in ROWS[method]}
    measured = {rows[point]: one for point, one in _measured(list(rows), task, result).items()}
    panels = []
    for row, point in measured.items():
        value = point.totals.si_psnr_y_db
        result.values.append(Value(SIDE_INFORMATION, PREDICTED.format(name, row), value or "none", ".1f"))
        if (planes := _planes(point, task.folder, ("original", "predicted"))) is not None:
            difference = planes[0] - planes[1]
            rms = float(np.sqrt(np.mean(np.square(difference, dtype=np.float64))))
            levels = np.clip(128 + NOISE_GAIN * difference, 0, 255).astype(np.uint8)
            panels.append(with_title(levels, f"{row}: rms {rms:.1f}"))
    lines = [(row, _predicted_db(point)) for row, point in measured.items()]
    result.plots["5.11", name] = _frames_plot(lines, f"{name}: predicted frames")
    if panels:
        result.pictures["5.12", name] = in_rows(panels, 2)
    return result


def _curves(sequence: str, task: Task, method: Method) -> StepResult:
    """Measure figures 5.13 to 5.15: rates, and predictions from lossy key frames."""
    result, name, preset = StepResult(), source_name(sequence), _preset(task)
    asked, curves = curve_points(sequence, preset, preset.frames, method), dict[str, Curve]()
    every = list(dict.fromkeys(point for points in asked.values() for point in points))
    measured = _measured(every, task, result)
    for label, points in asked.items():
        results = [measured[point] for point in points if point in measured]
        if results:
            ordered = tuple(sorted(results, key=lambda one: one.rate_kbps))
            curves[label] = Curve(label, label not in CODECS, ordered)
    for codec, reference in COMPARISONS:
        if codec in curves and reference in curves:
            pair = curves[reference], curves[codec]
            outcome = f"{crossing_text(*pair)}; {bd_rate_text(compare_curves(*pair))}"
            result.values.append(Value(CURVES, AGAINST.format(name, codec, reference), outcome))
    lines = [Line(label, curve.rates_kbps, curve.psnrs_y_db) for label, curve in curves.items()]
    result.plots["5.15", name] = line_plot(lines, name, "rate [kbit/s]", "luma PSNR [dB]")
    for codec in ("3D-DVC-TD", "3D-DVC-TE"):
        if codec in curves:
            rate = max(_tracks_bpp(point) for point in curves[codec].points)
            result.values.append(Value(TEXT, TRACKS.format(name, codec), rate, ".4f"))
    if "3D-DVC-TE" in curves:
        _lossy(name, curves["3D-DVC-TE"].points, task, result)
    return result


def _tracks_bpp(point: PointResult) -> float:
    """Return the rate of tracks in bits per pixel of all frames."""
    pixels = point.sequence.width * point.sequence.height * point.totals.frames
    return point.totals.bits.get("tracks", 0) / pixels


def _lossy(name: str, points: Sequence[PointResult], task: Task, result: StepResult) -> None:
    """Draw figures 5.13 and 5.14: key frames and predictions of one codec by QP."""
    lines = [(f"QP {one.key.qp}", {**_predicted_db(one), **_keys_db(one)}) for one in points]
    result.plots["5.13", name] = _frames_plot(lines, f"{name}: key and predicted frames")
    point = min(points, key=lambda point: abs((point.key.qp or 0) - SEEN_QP))
    files = point.pictures or PictureFiles()
    key_db = _keys_db(point).get(-1 if files.key_index is None else files.key_index)
    predicted_db = _predicted_db(point).get(-1 if files.index is None else files.index)
    planes = _planes(point, task.folder, ("key", "predicted"))
    panels = []
    for number, (label, title, psnr_db) in enumerate(
        ((KEY_FRAME, "key frame", key_db), (PREDICTED_FRAME, "predicted", predicted_db))
    ):
        if psnr_db is not None:
            result.values.append(Value(SEEN, label.format(name), psnr_db, ".1f"))
        if planes is not None:
            suffix = "" if psnr_db is None else f", {psnr_db:.1f} dB"
            panels.append(with_title(planes[number].astype(np.uint8), title + suffix))
    if panels:
        result.pictures["5.14", name] = in_rows(panels, 2)


def _correspondences(sequence: str, task: Task, _: Method) -> StepResult:
    """Draw figures 5.3 and 5.10: correspondences between the first two key frames, lossless and coarse."""
    name, processes = source_name(sequence), ProcessGroup()
    distance = LOSSLESS_GOP if task.frames is None else min(LOSSLESS_GOP, task.frames - 1)
    try:
        original = str(find_source(sequence, default_cache(), processes).path)
        with tempfile.TemporaryDirectory() as scratch:
            stream, decoded = str(Path(scratch) / "coarse.dvc"), str(Path(scratch) / "coarse.mkv")
            words = ["--codec", "2d", "--gop", "1", "--key-qp", str(COARSE_QP), "--frames", str(distance + 1)]
            processes.run(python_module("encoder", original, stream, *words, "--quiet"))
            processes.run(python_module("decoder", stream, decoded, "--quiet"))
            pictures = {
                ("5.3", name): _matches(processes, original, distance, Path(scratch) / "lossless"),
                ("5.10", name): _matches(processes, decoded, distance, Path(scratch) / "coarse"),
            }
    except DvcError as err:
        return StepResult(failures=[f"{name}: {err}"])
    return StepResult(pictures=pictures)


def _matches(processes: ProcessGroup, video: str, distance: int, folder: Path) -> Picture:
    words = ["--frames", "0", str(distance), "--sfm", "thesis", "--out", str(folder), "--quiet"]
    processes.run(python_module("sfm", video, video, *words))
    if not (folder / "correspondences.png").is_file():
        raise DvcError("dvc-sfm finds no depth between the key frames")
    return np.asarray(cv2.imread(str(folder / "correspondences.png"), cv2.IMREAD_COLOR), np.uint8)


def _steps(task: Task) -> list[Step]:
    sequences, preset = task.chosen, _preset(task)
    for sequence in sequences:
        catalogue(ProcessGroup(), "info", "--json", "--", sequence)  # fails without an original
    if not sequences:
        entries = catalogue(ProcessGroup(), "list", "--json")
        available = [entry["name"] for entry in entries if entry["kind"] == "file"]
        sequences = (*preset.scenes, *(name for name in preset.clips if name in available))
    steps = []
    for sequence in sequences:
        name = source_name(sequence)
        steps += [
            Step(f"correspondences-{name}", partial(_correspondences, sequence), (Method.THESIS,)),
            Step(f"side-information-{name}", partial(_side_information, sequence)),
            Step(f"curves-{name}", partial(_curves, sequence)),
        ]
    return steps


CHAPTER = load_chapter(5, _steps)
