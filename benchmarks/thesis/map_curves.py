"""Material and points of chapter 4: maps as whole files, pictures at equal bits of coefficients."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.thesis.scenes import MOTORCYCLE, PAIRS, motorcycle_files
from dvc.dibr.depth_image.depth_image_encoder import (
    CodedEdges,
    DepthImage,
    DepthOptions,
    code_edges,
    code_picture,
    encode_to_size,
)
from dvc.dibr.depth_image.depth_image_stream import (
    DepthScale,
    Plane,
    decode,
    decode_plane,
    decode_stream,
    default_hole,
    filled,
    read_depth_map,
)
from dvc.errors import ConfigError, DvcError
from dvc.images.chain_code import EdgeCode
from dvc.images.colour import Picture, luma
from dvc.images.edge_maps import EdgeMaps
from dvc.images.edge_selection import ladder, select
from dvc.images.lifting import most_levels
from dvc.metrics import psnr_db
from dvc.picture_files import read_picture

MAP_RATES = 0.02, 0.03, 0.04, 0.06, 0.08, 0.1, 0.15, 0.2, 0.25
QUICK_MAP_RATES = 0.03, 0.04, 0.1, 0.2
"""Bits per pixel of whole files, as in figure 4.8a."""
PRINTED_PEAKS = {"teddy": 53.0}
"""Peaks of PSNRs of maps in pixels, if the thesis gives one."""
EDGES_BPP = 0.015
"""Rate of the edges as written, in bits per pixel."""
ORDERS = {"SA9/7sym": 0, "SA9/7lin": 1, "SA9/7cub": 3}
"""Order of the extrapolation at edges, by the name of the transform."""
LINEAR = "SA9/7lin"
MOST_EDGES, BISECTIONS = 4.0, 8
"""Excess of bits that the first selection of edges may have, and steps of the search after it."""


@dataclass(frozen=True, eq=False)
class Material:
    """A map, with its picture or without."""

    name: str
    depth: Plane  # disparities or depth, holes filled
    peak: float  # peak of PSNRs, in units of the map
    picture: Picture | None = None  # luma

    def __post_init__(self) -> None:
        if self.picture is not None and self.picture.shape != self.depth.shape:
            sizes = [f"{shape[1]}x{shape[0]}" for shape in (self.picture.shape, self.depth.shape)]
            raise ConfigError(f"{self.name}: a map of {sizes[1]} for a picture of {sizes[0]}")

    def psnr_db(self, decoded: Plane) -> float:
        """Return the PSNR of a decoded map over all pixels."""
        mse = float(np.mean((decoded - self.depth) ** 2))
        return float(10.0 * np.log10(self.peak**2 / mse)) if mse else np.inf


def material_of_files(map_path: str | Path, image_path: str | Path | None = None) -> Material:
    """Read a map and its picture."""
    depth = read_depth_map(map_path, default_hole(map_path)).depth
    if not np.ptp(depth):
        raise DvcError(f"{map_path}: the map is constant")
    picture = None if image_path is None else luma(read_picture(image_path))
    return Material(Path(map_path).stem, depth, float(np.ptp(depth)), picture)


def material_of_set(name: str, data: Path) -> Material:
    """Read the reference view of a real set and its true disparities, or the Motorcycle pair."""
    if name == MOTORCYCLE:
        left, _, disparity = motorcycle_files()
        depth = filled(np.where(np.isfinite(disparity), disparity, np.nan).astype(np.float64))
        return Material(name, depth, float(np.ptp(depth)), luma(left))
    path = data / name / PAIRS[name].truth
    depth = read_depth_map(path, default_hole(path)).depth / PAIRS[name].scale
    peak = PRINTED_PEAKS.get(name, float(np.ptp(depth)))
    return Material(name, depth, peak, luma(PAIRS[name].pair(data)[0].image))


@dataclass(frozen=True, eq=False)
class MapPoint:
    """A map in a file, decoded."""

    num_bytes: int  # size of the file
    edge_bytes: int  # size of its edges
    psnr_db: float  # PSNR of all pixels
    depth: Plane  # decoded map
    edges: EdgeMaps  # edges of the transform

    @property
    def rate_bpp(self) -> float:
        """Bits of the file per pixel."""
        return 8.0 * self.num_bytes / self.depth.size

    @property
    def edges_bpp(self) -> float:
        """Bits of the edges per pixel."""
        return 8.0 * self.edge_bytes / self.depth.size


def map_point(
    material: Material, rate_bpp: float, edges: CodedEdges | None = None, order: int = DepthOptions.order
) -> MapPoint:
    """Write a map as a file of a rate, and decode it; without edges the encoder selects them."""
    options = DepthOptions(num_levels=num_levels(material.depth), order=order)
    image = DepthImage(material.depth, DepthScale.of(material.depth))
    encoded = encode_to_size(image, int(rate_bpp * material.depth.size / 8.0), edges, options)
    decoded = decode(decode_stream(encoded.data))
    psnr = material.psnr_db(decoded.depth)
    return MapPoint(len(encoded.data), encoded.part_bytes["edges"], psnr, decoded.depth, decoded.edges)


def num_levels(plane: Plane | Picture) -> int:
    """Return the number of levels of the transform of a picture."""
    return min(DepthOptions.num_levels, most_levels((plane.shape[0], plane.shape[1])))


def standard_point(material: Material, rate_bpp: float) -> MapPoint:
    """Write and decode a map without any edges."""
    shape = material.depth.shape[0], material.depth.shape[1]
    return map_point(material, rate_bpp, code_edges(EdgeMaps.none(shape)))


def map_curve(point: Callable[[float], MapPoint], rates: Sequence[float]) -> list[MapPoint]:
    """Measure a curve at the rates that are sufficient for the edges."""
    points = []
    for rate in rates:
        try:
            points.append(point(rate))
        except ConfigError:
            continue
    return points


def largest_gain(points: Sequence[MapPoint], standard: Sequence[MapPoint]) -> float:
    """Return the largest gain in PSNR at the rates of both curves."""
    rates = [point.rate_bpp for point in standard]
    psnrs = [point.psnr_db for point in standard]
    return max(point.psnr_db - float(np.interp(point.rate_bpp, rates, psnrs)) for point in points)


def fixed_edges(material: Material) -> CodedEdges:
    """Select the edges of all rates as written: as many as fit `EDGES_BPP` in code words."""
    max_bytes, order = EDGES_BPP * material.depth.size / 8.0, ORDERS[LINEAR]
    finer = None
    for step, edges in ladder(material.depth, 8.0 * MOST_EDGES * max_bytes, order):
        chosen = code_edges(edges, EdgeCode.FIXED)
        if len(chosen.data) <= max_bytes:
            break
        finer = step, edges
    else:
        return code_edges(EdgeMaps.none((material.depth.shape[0], material.depth.shape[1])))
    if finer is None:
        return chosen
    low, high = finer[0], step
    for _ in range(BISECTIONS):
        middle = (low * high) ** 0.5
        tried = code_edges(select(material.depth, finer[1], middle, order), EdgeCode.FIXED)
        if len(tried.data) <= max_bytes:
            high = middle
            chosen = max(chosen, tried, key=lambda coded: len(coded.data))
        else:
            low = middle
    return chosen


@dataclass(frozen=True)
class PicturePoint:
    """PSNRs of a picture in equally many bits of coefficients."""

    rate_bpp: float  # bits of coefficients per pixel
    standard_db: float  # without edges
    shape_adaptive_db: float  # with those of the map
    chosen_db: float  # as the encoder writes it: without edges if they do not help


def picture_points(
    picture: Picture, edges: EdgeMaps, rates: Sequence[float], order: int = 0
) -> Iterator[PicturePoint]:
    """Measure figure 4.8b: the bits of the edges count with the map."""
    options, shape = DepthOptions(num_levels=num_levels(picture)), (picture.shape[0], picture.shape[1])
    for rate in rates:
        psnrs = []
        for maps, is_free in ((None, False), (edges, False), (edges, True)):
            num_bytes = int(rate * picture.size / 8.0)
            code, has_edges = code_picture(picture, maps, num_bytes, options, order, is_free)
            decoded = decode_plane(code, edges if has_edges else None, shape)
            psnrs.append(psnr_db(decoded.picture(), picture))
        yield PicturePoint(rate, *psnrs)
