"""Rate-distortion points of both transforms: maps as whole files, pictures at equal bits of coefficients."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from dvc.dibr.codec.views import Picture
from dvc.dibr.depth_image.decoder import decode, decode_plane
from dvc.dibr.depth_image.depth_codes import CodedEdges, DepthOptions, code_edges
from dvc.dibr.depth_image.depth_scale import Plane
from dvc.dibr.depth_image.encoder import code_picture, encode_to_size
from dvc.dibr.depth_image.stream import decode_stream
from dvc.dibr.thesis.chapter4.material import Material
from dvc.dibr.wavelets.edge_maps import EdgeMaps
from dvc.dibr.wavelets.lifting import most_levels
from dvc.metrics import psnr_db

STANDARD, SHAPE_ADAPTIVE = "standard", "shape-adaptive"
TRANSFORMS = STANDARD, SHAPE_ADAPTIVE
MAP_RATES = 0.02, 0.03, 0.04, 0.06, 0.08, 0.1, 0.15, 0.2, 0.25
"""Bits per pixel of whole files, as in figure 4.8a."""
PICTURE_RATES = 0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0
"""Bits of coefficients per pixel, as in figure 4.8b."""


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

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers."""
        bits = {name: 8 * size for name, size in self.part_bytes.items()}
        return {
            "bytes": self.num_bytes,
            "bpp": self.rate_bpp,
            "psnr_db": self.psnr_db,
            "bits": bits,
            "edge_elements": self.edges.count(),
        }


@dataclass(frozen=True)
class PicturePoint:
    """A picture in as many bits of coefficients by all transforms."""

    rate_bpp: float  # bits of coefficients per pixel
    standard_db: float  # PSNR without edges, and with those of the map
    shape_adaptive_db: float
    chosen_db: float  # PSNR of what the encoder writes, which leaves edges out where they do not help

    @property
    def gain_db(self) -> float:
        """Of what the encoder writes."""
        return self.chosen_db - self.standard_db


def map_point(material: Material, rate_bpp: float, transform: str = SHAPE_ADAPTIVE) -> MapPoint:
    """Write a map as a file of a rate, and decode it."""
    none = code_edges(EdgeMaps.none((material.depth.shape[0], material.depth.shape[1])))
    edges = None if transform == SHAPE_ADAPTIVE else none
    max_bytes = int(rate_bpp * material.num_pixels / 8.0)
    encoded = encode_to_size(material.image, max_bytes, edges, _options(material))
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


def map_curves(
    material: Material, rates: Sequence[float], advance: Callable[[int], None] = lambda _: None
) -> dict[str, list[MapPoint]]:
    """Measure figure 4.8a."""
    curves: dict[str, list[MapPoint]] = {name: [] for name in TRANSFORMS}
    for rate, name in product(rates, TRANSFORMS):
        curves[name].append(map_point(material, rate, name))
        advance(1)
    return curves


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


def coded_edges(point: MapPoint) -> CodedEdges:
    """Return the edges of a file as an encoder takes them."""
    return code_edges(point.edges)


def largest_gain(curves: dict[str, list[MapPoint]]) -> tuple[float, float]:
    """Return how much the shape-adaptive transform gains at most."""
    gains = [
        (ours.psnr_db - theirs.psnr_db, ours.rate_bpp)
        for ours, theirs in zip(curves[SHAPE_ADAPTIVE], curves[STANDARD], strict=True)
    ]
    return max(gains)


def _options(material: Material) -> DepthOptions:
    shape = material.depth.shape[0], material.depth.shape[1]
    return DepthOptions(num_levels=min(DepthOptions.num_levels, most_levels(shape)))


def rounded_psnr(value: float) -> float | None:
    """Return a PSNR as JSON can have it."""
    return value if np.isfinite(value) else None
