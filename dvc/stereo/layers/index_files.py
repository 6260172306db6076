"""Index files of folders: JSON that names pictures and maps, read strictly; and those files."""

import json
import math
from pathlib import Path
from typing import Any, NoReturn

import cv2
import numpy as np
from numpy.typing import NDArray

from dvc.array_files import MAX_LABELS
from dvc.errors import DvcError
from dvc.multiview.camera_array import DisparityLabels
from dvc.pfm import read_pfm
from dvc.stereo.layers.canvas import Canvas, Frame

MAX_SIDE = 1 << 15
"""Larger pictures are refused."""
MAX_DISPARITY = 1e6
"""Larger magnitudes of numbers are refused."""


class Entry:
    """An object of an index file; whatever is missing in it or of another kind is one line of complaint.

    Parameters
    ----------
    path : Path
        The file, for messages and as the place of the files that it names.
    values : object
        What was found there.
    where : str, optional
        Which object it is.
    """

    def __init__(self, path: Path, values: object, where: str = "") -> None:
        self.path, self.where = path, where
        if not isinstance(values, dict):
            self.refuse("expected an object")
        self._values = values

    def refuse(self, reason: str) -> NoReturn:
        """Raise an error.

        Parameters
        ----------
        reason : str
            What is wrong.

        Raises
        ------
        DvcError
            Always.
        """
        raise DvcError(f"{self.path}: {self.where + ': ' if self.where else ''}{reason}")

    def value(self, key: str) -> Any:
        """Return a value of any kind.

        Parameters
        ----------
        key : str
            Its name.

        Returns
        -------
        object
            The value.
        """
        if key not in self._values:
            self.refuse(f"no {key!r}")
        return self._values[key]

    def integer(self, key: str, low: int, high: int) -> int:
        """Return a whole number.

        Parameters
        ----------
        key : str
            Its name.
        low, high : int
            Bounds that are accepted.

        Returns
        -------
        int
            The number.
        """
        value = self.value(key)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            self.refuse(f"{key!r} is no whole number from {low} to {high}")
        return value

    def number(self, key: str, above: float = -math.inf) -> float:
        """Return a finite number.

        Parameters
        ----------
        key : str
            Its name.
        above : float, optional
            It must be larger.

        Returns
        -------
        float
            The number.
        """
        return self._number(self.value(key), key, above)

    def _number(self, value: object, key: str, above: float = -math.inf) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse(f"{key!r} is no number")
        if not abs(value) <= MAX_DISPARITY or not value > above:
            self.refuse(f"{key!r} is out of range")
        return float(value)

    def text(self, key: str) -> str:
        """Return a text.

        Parameters
        ----------
        key : str
            Its name.

        Returns
        -------
        str
            The text.
        """
        value = self.value(key)
        if not isinstance(value, str):
            self.refuse(f"{key!r} is no text")
        return value

    def entry(self, key: str) -> "Entry":
        """Return an object.

        Parameters
        ----------
        key : str
            Its name.

        Returns
        -------
        Entry
            The object.
        """
        return Entry(self.path, self.value(key), key)

    def entries(self, key: str, most: int) -> list["Entry"]:
        """Return a list of objects.

        Parameters
        ----------
        key : str
            Its name.
        most : int
            A longer list is refused.

        Returns
        -------
        list of Entry
            At least one object.
        """
        values = self.value(key)
        if not isinstance(values, list) or not 1 <= len(values) <= most:
            self.refuse(f"{key!r} is no list of 1 to {most}")
        return [Entry(self.path, value, f"{key} {index}") for index, value in enumerate(values)]

    def matrix(self, key: str, size: int) -> NDArray[np.float64]:
        """Return a square matrix that can be inverted.

        Parameters
        ----------
        key : str
            Its name.
        size : int
            Number of rows and columns.

        Returns
        -------
        ndarray of shape (size, size), float64
            The matrix.
        """
        rows = self.value(key)
        if not isinstance(rows, list) or any(not isinstance(row, list) or len(row) != size for row in rows):
            self.refuse(f"{key!r} is no {size}x{size} matrix")
        matrix = np.array([[self._number(value, key) for value in row] for row in rows], np.float64)
        if matrix.shape != (size, size) or not np.linalg.cond(matrix) < 1e15:
            self.refuse(f"{key!r} is no {size}x{size} matrix that can be inverted")
        return matrix

    def file(self, key: str) -> Path:
        """Return a file of the folder.

        Parameters
        ----------
        key : str
            Under which its name stands.

        Returns
        -------
        Path
            Where it is.
        """
        name = self.text(key)
        if Path(name).name != name or not name.isprintable() or not name:
            self.refuse(f"{name!r} is no name of a file in the folder")
        return self.path.parent / name


def read_index(path: Path, format_name: str, version: int, writer: str) -> Entry:
    """Read an index file.

    Parameters
    ----------
    path : Path
        The file.
    format_name : str
        What its `format` must say.
    version : int
        What its `version` must be.
    writer : str
        The command that writes such files, for messages.

    Returns
    -------
    Entry
        Its object.

    Raises
    ------
    DvcError
        If it is something else, or of another version.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as err:
        raise DvcError(f"{path}: not a JSON file") from err
    if not isinstance(values, dict) or values.get("format") != format_name:
        raise DvcError(f"{path}: not what `{writer}` writes")
    if values.get("version") != version:
        raise DvcError(f"{path}: version {values.get('version')!r} is not known, only {version}")
    return Entry(path, values)


def canvas_values(canvas: Canvas) -> dict[str, Any]:
    """Return what an index file tells of a canvas; inverse of `read_canvas`.

    Parameters
    ----------
    canvas : Canvas
        The canvas.

    Returns
    -------
    dict
        JSON-safe values.
    """
    homography = canvas.world_from_rectified
    return {
        "width": canvas.shape[1],
        "height": canvas.shape[0],
        "frame": canvas.frame._asdict(),
        "disparities": canvas.labels._asdict(),
        "resolution": canvas.resolution,
        "reference": canvas.reference,
        "num_cameras": canvas.num_cameras,
        "world_from_rectified": None if homography is None else homography.tolist(),
        "depth": canvas.depth_scale._asdict(),
    }


def read_canvas(index: Entry) -> Canvas:
    """Read a canvas from an index file; inverse of `canvas_values`.

    Parameters
    ----------
    index : Entry
        The object of the file.

    Returns
    -------
    Canvas
        The canvas.

    Raises
    ------
    DvcError
        If something is missing or makes no sense.
    """
    shape = index.integer("height", 1, MAX_SIDE), index.integer("width", 1, MAX_SIDE)
    inner = index.entry("frame")
    left, top = inner.integer("left", 0, shape[1] - 1), inner.integer("top", 0, shape[0] - 1)
    width, height = inner.integer("width", 1, shape[1] - left), inner.integer("height", 1, shape[0] - top)
    disparities = index.entry("disparities")
    labels = DisparityLabels(
        disparities.number("lowest"),
        disparities.number("step", 0.0),
        disparities.integer("num_labels", 1, MAX_LABELS),
    )
    matrix = None if index.value("world_from_rectified") is None else index.matrix("world_from_rectified", 4)
    if matrix is not None and matrix[3, 2] == 0.0:
        index.refuse("'world_from_rectified' gives no depth")
    return Canvas(
        shape,
        Frame(left, top, width, height),
        labels,
        index.number("resolution", 0.0),
        index.text("reference"),
        index.integer("num_cameras", 1, 1 << 15),
        matrix,
    )


def read_plane(path: Path, channels: int, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Read a PNG file of eight bits as it was written.

    Parameters
    ----------
    path : Path
        The file.
    channels : int
        1: grey; 4: red, green, blue and opacity.
    shape : tuple of int
        Height and width that it must have.

    Returns
    -------
    ndarray of shape (H, W) or (H, W, 4), uint8
        Levels.

    Raises
    ------
    DvcError
        If it is something else.
    """
    content = np.fromfile(path, np.uint8)
    try:
        stored = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    except cv2.error:
        stored = None
    expected = shape if channels == 1 else (*shape, channels)
    if stored is None or stored.dtype != np.uint8 or stored.shape != expected:
        kind = "grey" if channels == 1 else "RGBA"
        raise DvcError(f"{path}: not an eight-bit {kind} picture of {shape[1]}x{shape[0]}")
    return np.asarray(stored if channels == 1 else stored[:, :, [2, 1, 0, 3]], np.uint8)


def read_disparity(path: Path, mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Read disparities that are known where there is something, and infinite elsewhere.

    Parameters
    ----------
    path : Path
        PFM file.
    mask : ndarray of shape (H, W), bool
        Where there is something.

    Returns
    -------
    ndarray of shape (H, W), float32
        Disparities; 0 where there is nothing.

    Raises
    ------
    DvcError
        If the file is damaged, of another size, or does not fit the mask.
    """
    disparity = read_pfm(path)
    if disparity.shape != mask.shape:
        found, expected = disparity.shape, mask.shape
        raise DvcError(f"{path}: {found[1]}x{found[0]}, expected {expected[1]}x{expected[0]}")
    if not np.array_equal(np.abs(disparity) <= MAX_DISPARITY, mask) or not (disparity[~mask] == np.inf).all():
        raise DvcError(f"{path}: values are not where the picture has them")
    return np.where(mask, disparity, np.float32(0.0))
