"""Rate-distortion points of both transforms: maps as whole files, pictures at equal bits of coefficients."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.thesis.chapter4.material import Material
from dvc.dibr.depth_image.decoder import decode, decode_plane
from dvc.dibr.depth_image.depth_codes import CodedEdges, DepthOptions, code_edges
from dvc.dibr.depth_image.depth_scale import Plane
from dvc.dibr.depth_image.encoder import code_picture, encode_to_size
from dvc.dibr.depth_image.stream import decode_stream
from dvc.errors import ConfigError
from dvc.images.colour import Picture
from dvc.images.wavelets.edge_maps import EdgeMaps
from dvc.images.wavelets.lifting import most_levels
from dvc.metrics import psnr_db


@dataclass(frozen=True, eq=False)
class MapPoint:
    """A map in a file, decoded."""

    num_bytes: int  # of the file
    part_bytes: dict[str, int]  # of `header`, `edges` and `depth`
    psnr_db: float  # all pixels
    rate_bpp: float  # of the whole file
    depth: Plane  # the decoded map
    edges: EdgeMaps  # where the transform stopped

    @property
    def edges_bpp(self) -> float:
        """Bits of the edges per pixel."""
        return 8.0 * self.part_bytes["edges"] / self.depth.size


@dataclass(frozen=True)
class PicturePoint:
    """A picture in as many bits of coefficients by all transforms."""

    rate_bpp: float  # bits of coefficients per pixel
    standard_db: float  # PSNR without edges, and with those of the map
    shape_adaptive_db: float
    chosen_db: float  # PSNR of what the encoder writes, which leaves edges out where they do not help


def map_point(
    material: Material, rate_bpp: float, edges: CodedEdges | None = None, order: int = DepthOptions.order
) -> MapPoint:
    """Write a map as a file of a rate, and decode it; without edges those are selected that are worth it."""
    max_bytes = int(rate_bpp * material.num_pixels / 8.0)
    shape = material.depth.shape[0], material.depth.shape[1]
    options = DepthOptions(num_levels=min(DepthOptions.num_levels, most_levels(shape)), order=order)
    encoded = encode_to_size(material.image, max_bytes, edges, options)
    decoded = decode(decode_stream(encoded.data))
    parts = {name: size for name, size in encoded.part_bytes.items() if name != "image"}
    return MapPoint(
        len(encoded.data),
        parts,
        material.psnr_db(decoded.depth),
        8.0 * len(encoded.data) / material.num_pixels,
        decoded.depth,
        decoded.edges,
    )


def standard_point(material: Material, rate_bpp: float) -> MapPoint:
    """Do the same without any edges."""
    shape = material.depth.shape[0], material.depth.shape[1]
    return map_point(material, rate_bpp, code_edges(EdgeMaps.none(shape)))


def map_curve(point: Callable[[float], MapPoint], rates: Sequence[float]) -> list[MapPoint]:
    """Measure a curve at those of some rates that are enough for the edges."""
    found = []
    for rate in rates:
        try:
            found.append(point(rate))
        except ConfigError:
            continue
    return found


def picture_points(
    picture: Picture, edges: EdgeMaps, rates: Sequence[float], order: int = 0
) -> Iterator[PicturePoint]:
    """Measure figure 4.8b: the bits of the edges count with the map."""
    num_levels = min(DepthOptions.num_levels, most_levels((picture.shape[0], picture.shape[1])))
    options = DepthOptions(num_levels=num_levels)
    for rate in rates:
        num_bytes = int(rate * picture.size / 8.0)
        found = []
        for maps, is_free in ((None, False), (edges, False), (edges, True)):
            code, with_edges = code_picture(picture, maps, num_bytes, options, order, is_free)
            decoded = decode_plane(code, edges if with_edges else None, (picture.shape[0], picture.shape[1]))
            found.append(psnr_db(decoded.picture(), picture))
        yield PicturePoint(rate, *found)


def largest_gain(points: Sequence[MapPoint], standard: Sequence[MapPoint]) -> float:
    """Return how much is gained at most, at the rates that both curves have."""
    rates = [point.rate_bpp for point in standard]
    psnrs = [point.psnr_db for point in standard]
    return max(point.psnr_db - float(np.interp(point.rate_bpp, rates, psnrs)) for point in points)
