"""What the folders of layers and of sprites share: the canvas in their index files, and maps with holes."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.array_files import MAX_NUMBER
from dvc.errors import DvcError
from dvc.index_files import MAX_SIDE, Entry, read_labels
from dvc.layers.canvas import Canvas, Frame
from dvc.pfm import read_pfm


def canvas_values(canvas: Canvas) -> dict[str, Any]:
    """Return what an index file tells of a canvas; inverse of `read_canvas`."""
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
    """Read a canvas from an index file; inverse of `canvas_values`."""
    shape = index.integer("height", 1, MAX_SIDE), index.integer("width", 1, MAX_SIDE)
    inner = index.entry("frame")
    left, top = inner.integer("left", 0, shape[1] - 1), inner.integer("top", 0, shape[0] - 1)
    width, height = inner.integer("width", 1, shape[1] - left), inner.integer("height", 1, shape[0] - top)
    labels = read_labels(index.entry("disparities"))
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


def read_disparity(path: Path, mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Read disparities that are known where there is something, and infinite elsewhere."""
    disparity = read_pfm(path)
    if disparity.shape != mask.shape:
        found, expected = disparity.shape, mask.shape
        raise DvcError(f"{path}: {found[1]}x{found[0]}, expected {expected[1]}x{expected[0]}")
    if not np.array_equal(np.abs(disparity) <= MAX_NUMBER, mask) or not (disparity[~mask] == np.inf).all():
        raise DvcError(f"{path}: values are not where the picture has them")
    return np.where(mask, disparity, np.float32(0.0))
