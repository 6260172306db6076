"""Pictures of chapter 5 of the thesis, from results alone."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dvc.files import atomic_output
from dvc.rd.pictures import read_picture
from dvc.rd.plots import ANCHOR_COLOURS, ANCHOR_MARKERS, COLOURS, DPI, MARKERS
from dvc.rd.results import PointResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE_INCHES = (8.0, 4.0)
IDENTICAL_DB = 100.0
NOISE_GAIN = 4


def draw_side_information(methods: Mapping[str, PointResult], path: Path) -> Path | None:
    """Draw the PSNR of every predicted frame, one line per method: figure 5.11.

    Parameters
    ----------
    methods : mapping of str to PointResult
        Points with lossless key frames, by name of the method.
    path : Path
        Name of the picture without suffix.

    Returns
    -------
    Path or None
        The picture; None if there is nothing to draw.

    Raises
    ------
    DvcError
        If it cannot be written.
    """
    if not methods:
        return None
    with _picture(path.with_name(path.name + ".png"), "predicted frames: luma PSNR [dB]") as axes:
        for number, (name, point) in enumerate(methods.items()):
            _line(axes, number, name, _predicted(point))
    return path.with_name(path.name + ".png")


def draw_lossy_keys(points: Sequence[PointResult], path: Path) -> Path | None:
    """Draw the PSNR of key frames and predicted frames, one line per QP: figure 5.13.

    Parameters
    ----------
    points : sequence of PointResult
        One per QP.
    path : Path
        Name of the picture without suffix.

    Returns
    -------
    Path or None
        The picture; None if there is nothing to draw.

    Raises
    ------
    DvcError
        If it cannot be written.
    """
    if not points:
        return None
    with _picture(path.with_name(path.name + ".png"), "key and predicted frames: luma PSNR [dB]") as axes:
        for number, point in enumerate(points):
            lossless = point.data["key"].get("lossless")
            name = "lossless key frames" if lossless else f"QP {point.data['key']['qp']}"
            predicted = _predicted(point)
            keys = {} if lossless else _keys(point)
            _line(axes, number, name, {**predicted, **keys})
    return path.with_name(path.name + ".png")


def draw_noise(methods: Mapping[str, PointResult], folder: Path, path: Path) -> Path | None:
    """Draw the difference between one frame and its prediction by each method: figure 5.12.

    Parameters
    ----------
    methods : mapping of str to PointResult
        Points with lossless key frames, by name of the method; those without pictures are left out.
    folder : Path
        Of the experiment, where the pictures of points lie.
    path : Path
        Name of the picture without suffix.

    Returns
    -------
    Path or None
        The picture; None if there is nothing to draw.

    Raises
    ------
    DvcError
        If it cannot be written.
    """
    noises = {name: _noise(point, folder) for name, point in methods.items()}
    found = {name: noise for name, noise in noises.items() if noise is not None}
    if not found:
        return None
    panels = []
    for name, noise in found.items():
        error = float(np.sqrt(np.mean(np.square(noise, dtype=np.float64))))
        panels.append((f"{name}, rms {error:.1f}", np.clip(128 + NOISE_GAIN * noise, 0, 255)))
    return _draw_panels(panels, path)


def draw_qualities(point: PointResult | None, folder: Path, path: Path) -> Path | None:
    """Draw a decoded key frame beside a frame that is predicted from it: figure 5.14.

    Parameters
    ----------
    point : PointResult or None
        With lossy key frames.
    folder : Path
        Of the experiment, where the pictures of points lie.
    path : Path
        Name of the picture without suffix.

    Returns
    -------
    Path or None
        The picture; None if there is nothing to draw.

    Raises
    ------
    DvcError
        If it cannot be written.
    """
    planes = None if point is None else _planes(point, folder, ("key", "predicted"))
    if point is None or planes is None:
        return None
    pictures = point.data["pictures"]
    frames = (
        (pictures.get("key_index"), _keys(point), "key"),
        (pictures.get("index"), _predicted(point), "predicted"),
    )
    panels = [
        (f"{kind} frame {index}, {psnrs_db.get(index, np.nan):.1f} dB", plane)
        for plane, (index, psnrs_db, kind) in zip(planes, frames, strict=True)
    ]
    return _draw_panels(panels, path)


def _draw_panels(panels: Sequence[tuple[str, NDArray[np.int16]]], path: Path) -> Path:
    """Draw pictures under their titles, two in a row."""
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    file = path.with_name(path.name + ".png")
    with _figure(file, (4.2 * columns, 3.7 * rows)) as figure:
        for number, (title, plane) in enumerate(panels, 1):
            axes = figure.add_subplot(rows, columns, number)
            axes.imshow(plane, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
            axes.set_title(title, fontsize=9)
            axes.set_axis_off()
    return file


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


def _noise(point: PointResult, folder: Path) -> NDArray[np.int16] | None:
    """Return original minus prediction, if both pictures are there and of one size."""
    planes = _planes(point, folder, ("original", "predicted"))
    return None if planes is None else planes[0] - planes[1]


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


def _line(axes: "Axes", number: int, name: str, psnrs_db: Mapping[int, float]) -> None:
    indices = sorted(psnrs_db)
    values = [min(psnrs_db[index], IDENTICAL_DB) for index in indices]
    colours, markers = (*COLOURS, *ANCHOR_COLOURS[:1]), (*MARKERS, *ANCHOR_MARKERS[:1])
    colour, marker = colours[number % len(colours)], markers[number % len(markers)]
    axes.plot(indices, values, color=colour, marker=marker, markersize=4, linewidth=1, label=name)


@contextmanager
def _picture(path: Path, title: str) -> "Iterator[Axes]":
    with _figure(path, SIZE_INCHES) as figure:
        axes = figure.add_subplot()
        yield axes
        axes.set_xlabel("frame")
        axes.set_ylabel(title)
        axes.grid(color="#dddddd", linewidth=0.8)
        axes.set_axisbelow(True)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)


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
