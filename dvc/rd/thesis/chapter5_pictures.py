"""Pictures of chapter 5 of the thesis, from results alone."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dvc.files import atomic_output
from dvc.page.plotting import COLOURS, DPI, MARKERS
from dvc.rd.pictures import read_picture
from dvc.rd.plots import ANCHOR_COLOURS, ANCHOR_MARKERS
from dvc.rd.point_result import PointResult
from dvc.rd.thesis.chapter5_curves import ChapterPoints

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE_INCHES = (8.0, 4.0)
IDENTICAL_DB = 100.0
NOISE_GAIN = 4
Line = tuple[str, Mapping[int, float]]
"""Name, and PSNR in dB by number of the frame."""
Panel = tuple[str, NDArray[np.int16]]
"""Title and picture."""


def draw_pictures(points: ChapterPoints, folder: Path, stem: str) -> dict[str, str]:
    """Draw figures 5.11 to 5.14 of a sequence, as far as there is anything to draw."""
    names = {number: f"{stem}-{number}.png" for number in ("5.11", "5.12", "5.13", "5.14")}
    lossy = _lossy_lines(points.lossy.values())
    drawn = {
        "5.11": _draw_lines(_predicted_lines(points.lossless), "predicted frames", folder / names["5.11"]),
        "5.12": _draw_panels(_noise_panels(points.lossless, folder), folder / names["5.12"]),
        "5.13": _draw_lines(lossy, "key and predicted frames", folder / names["5.13"]),
        "5.14": _draw_panels(_quality_panels(points.seen, folder), folder / names["5.14"]),
    }
    return {number: names[number] for number, is_drawn in drawn.items() if is_drawn}


def _predicted_lines(methods: Mapping[str, PointResult]) -> list[Line]:
    """Return the PSNR of every predicted frame, one line per method."""
    return [(name, _predicted(point)) for name, point in methods.items()]


def _lossy_lines(points: Iterable[PointResult]) -> list[Line]:
    """Return the PSNR of key frames, unless they are lossless, and predicted frames, one line per point."""
    lines: list[Line] = []
    for point in points:
        lossless = point.data["key"].get("lossless")
        name = "lossless key frames" if lossless else f"QP {point.data['key']['qp']}"
        lines.append((name, {**_predicted(point), **({} if lossless else _keys(point))}))
    return lines


def _noise_panels(methods: Mapping[str, PointResult], folder: Path) -> list[Panel]:
    """Return the difference between one frame and its prediction by each method that has pictures."""
    panels = []
    for name, point in methods.items():
        planes = _planes(point, folder, ("original", "predicted"))
        if planes is not None:
            noise = planes[0] - planes[1]
            error = float(np.sqrt(np.mean(np.square(noise, dtype=np.float64))))
            panels.append((f"{name}, rms {error:.1f}", np.clip(128 + NOISE_GAIN * noise, 0, 255)))
    return panels


def _quality_panels(point: PointResult | None, folder: Path) -> list[Panel]:
    """Return a decoded key frame and a frame that is predicted from it."""
    planes = None if point is None else _planes(point, folder, ("key", "predicted"))
    if point is None or planes is None:
        return []
    pictures = point.data["pictures"]
    frames = (
        (pictures.get("key_index"), _keys(point), "key"),
        (pictures.get("index"), _predicted(point), "predicted"),
    )
    return [
        (f"{kind} frame {index}, {psnrs_db.get(index, np.nan):.1f} dB", plane)
        for plane, (index, psnrs_db, kind) in zip(planes, frames, strict=True)
    ]


def _draw_panels(panels: Sequence[Panel], path: Path) -> bool:
    """Draw pictures under their titles, two in a row; false if there are none."""
    if not panels:
        return False
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    with _figure(path, (4.2 * columns, 3.7 * rows)) as figure:
        for number, (title, plane) in enumerate(panels, 1):
            axes = figure.add_subplot(rows, columns, number)
            axes.imshow(plane, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
            axes.set_title(title, fontsize=9)
            axes.set_axis_off()
    return True


def _draw_lines(lines: Sequence[Line], what: str, path: Path) -> bool:
    """Draw PSNRs over frame numbers; false if there are no lines."""
    if not lines:
        return False
    colours, markers = (*COLOURS, *ANCHOR_COLOURS[:1]), (*MARKERS, *ANCHOR_MARKERS[:1])
    with _figure(path, SIZE_INCHES) as figure:
        axes = figure.add_subplot()
        for number, (name, psnrs_db) in enumerate(lines):
            indices = sorted(psnrs_db)
            values = [min(psnrs_db[index], IDENTICAL_DB) for index in indices]
            colour, marker = colours[number % len(colours)], markers[number % len(markers)]
            axes.plot(indices, values, color=colour, marker=marker, markersize=4, linewidth=1, label=name)
        axes.set_xlabel("frame")
        axes.set_ylabel(f"{what}: luma PSNR [dB]")
        axes.grid(color="#dddddd", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    return True


def _predicted(point: PointResult) -> dict[int, float]:
    """Return the PSNR of each predicted frame, by its number."""
    return {
        frame["index"]: frame["si_psnr_y_db"]
        for frame in point.data.get("per_frame", ())
        if isinstance(frame.get("si_psnr_y_db"), (int, float))
    }


def _keys(point: PointResult) -> dict[int, float]:
    frames = point.data.get("per_frame", ())
    return {frame["index"]: frame["psnr_y_db"] for frame in frames if frame["type"] == "key"}


def _planes(point: PointResult, folder: Path, names: tuple[str, str]) -> list[NDArray[np.int16]] | None:
    """Return two pictures of a point, if both are there and of one size."""
    pictures: dict[str, Any] = point.data.get("pictures") or {}
    planes = []
    for name in names:
        path = pictures.get(name)
        plane = read_picture(folder / path) if isinstance(path, str) else None
        if plane is None:
            return None
        planes.append(np.asarray(plane, dtype=np.int16))
    return planes if planes[0].shape == planes[1].shape else None


@contextmanager
def _figure(path: Path, size_inches: tuple[float, float]) -> "Iterator[Figure]":
    """Give a figure, and write it to a file at the end."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_inches, layout="constrained")
    FigureCanvasAgg(figure)
    yield figure
    with atomic_output(path) as temporary:
        figure.savefig(temporary, format="png", dpi=DPI)
