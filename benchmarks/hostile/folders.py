"""Maps, pictures, and folders of layers, sprites and reconstructions; their readers."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.hostile.files import Files, written
from benchmarks.hostile.layered_pieces import good_streams
from dvc.dibr.depth_image.depth_scale import read_depth_map
from dvc.dibr.depth_image.piece_stream import decode, decode_stream
from dvc.dibr.depth_image.scene_pieces import read_pieces, write_pieces
from dvc.geometry.camera_array import (
    ArrayView,
    CameraArray,
    DisparityLabels,
    LatticePosition,
    Reconstruction,
    Surface,
)
from dvc.images.edge_extraction import read_edges, write_edges
from dvc.images.edge_maps import EdgeMaps
from dvc.picture_files import read_picture, write_pfm, write_png
from dvc.stereo.surfaces.surface_folder import INDEX, read_reconstruction, write_reconstruction

_SHAPE = 18, 26


@cache
def good_maps() -> tuple[Files, ...]:
    """Return a float map, one of 16 bits, a picture in colour, and edges."""
    rng = np.random.default_rng(2)
    levels, colours = rng.integers(0, 2**16, _SHAPE, np.uint16), rng.integers(0, 256, (*_SHAPE, 3), np.uint8)
    rows, columns = (rng.integers(0, 2, _SHAPE, np.uint8) for _ in range(2))

    def _png(name: str) -> Callable[[Path], object]:
        picture = np.asarray(levels if name == "map.png" else colours)
        return lambda folder: write_png(folder / name, picture)

    rows[-1], columns[:, -1] = 0, 0
    return (
        written(lambda folder: write_pfm(folder / "map.pfm", levels.astype(np.float32))),
        written(_png("map.png")),
        written(_png("colours.png")),
        written(lambda folder: write_edges(folder / "edges.png", EdgeMaps(rows, columns))),
    )


def read_maps(folder: Path) -> bool:
    """Read the one that is there."""
    (path,) = folder.iterdir()
    if path.stem == "map":
        return bool(np.isfinite(read_depth_map(path, 0.0).depth).all())
    if path.stem == "edges":
        return read_edges(path, _SHAPE).shape == _SHAPE
    return read_picture(path).shape[2:] == (3,)


@cache
def good_folders() -> tuple[Files, ...]:
    """Return layers, sprites, and a reconstruction."""
    rng = np.random.default_rng(4)
    pieces = [decode(decode_stream(data)) for data in good_streams()]
    views, surfaces = [], []
    for m in range(2):
        image, valid = rng.integers(0, 256, (*_SHAPE, 3), np.uint8), rng.random(_SHAPE) < 0.9
        views.append(ArrayView(f"{m}", image, LatticePosition(float(m), 0.0), valid if m else None))
        disparity = rng.uniform(0.0, 5.0, _SHAPE).astype(np.float32)
        surfaces.append(Surface(disparity, ~valid, valid.astype(np.float32)))
    whole = Reconstruction(CameraArray(tuple(views)), DisparityLabels(0.0, 1.0, 6), tuple(surfaces), {})
    return (
        *(written(lambda folder, one=one: write_pieces(folder, one.scene)) for one in pieces[1:]),  # type: ignore[misc]
        written(lambda folder: write_reconstruction(folder, whole)),
    )


def read_folders(folder: Path) -> bool:
    """Read what is there."""
    if (folder / INDEX).exists():
        return all(np.isfinite(surface.disparity).all() for surface in read_reconstruction(folder).surfaces)
    return all(np.isfinite(piece.disparity).all() for piece in read_pieces(folder).pieces)
