"""Rate-distortion curves of chapter 3, measured on views that are rendered from decoded files."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.picture_coders import Quality, quality_of
from benchmarks.baselines.thesis_disparities import FixedQuadtreeCodec, LaplacianCodec
from benchmarks.thesis.harness import Method
from dvc.dibr.disparity.disparity_codec import DisparityCodec
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM, S_TRANSFORM
from dvc.dibr.disparity.square_codecs import BlockCodec, QuadtreeCodec
from dvc.dibr.view_encoder import Encoded, ViewEncoder
from dvc.dibr.view_rendering import PictureAndDisparity, picture_of, render
from dvc.dibr.view_set import Views
from dvc.dibr.view_stream import METHODS, Decoded, decode, decode_stream, encode_layer
from dvc.errors import RdCurveError
from dvc.geometry.camera_array import DisparityLabels
from dvc.geometry.view_synthesis import fill_from_background
from dvc.geometry.viewpoints import Viewpoint, warp_between
from dvc.geometry.warping import EMPTY
from dvc.images import picture_codec
from dvc.images.colour import Picture
from dvc.images.picture_codec import multipliers_around
from dvc.metrics import bd_psnr, bd_rate

Floats = NDArray[np.float64]
REFERENCE_BPP, QUICK_BPP = (0.1, 0.25, 0.5, 0.75, 1.0), (0.1, 0.25, 0.5, 1.0)
"""Rates of the reference view that lambdas are chosen for."""
ANCHOR = "quadtree"
PLAIN_QUADTREE = "quadtree without credits"
"""Our quadtree without the search that L and S have."""


class Coder(NamedTuple):
    """A codec of disparities, and the kind of stream that it is written as."""

    kind: str
    codec: DisparityCodec


CODERS: Mapping[Method, Mapping[str, Coder]] = {
    Method.THESIS: {
        "l": Coder("l", LaplacianCodec(L_TRANSFORM)),
        "s": Coder("s", LaplacianCodec(S_TRANSFORM)),
        "quadtree": Coder("quadtree", FixedQuadtreeCodec()),
        "blocks": Coder("blocks", BlockCodec()),
    },
    Method.DEFAULT: {
        **{name: Coder(name, codec) for name, codec in METHODS.items()},
        "quadtree": Coder("quadtree", QuadtreeCodec(has_credits=True)),
        PLAIN_QUADTREE: Coder("quadtree", QuadtreeCodec()),
    },
}
"""Codecs of disparities by name; as written, none of them considers rendered views."""


@dataclass(frozen=True, eq=False)
class Point:
    """One decoded file, and all views rendered from it."""

    multiplier: float  # squared error, intensities from 0 to 1, that the last bit of a pixel saves
    num_bytes: int  # size of the file, or of its first layers
    num_pixels: int  # pixels of the reference
    picture_bytes: int  # parts of the size
    disparity_bytes: int
    quality: Quality  # PSNR of all views
    pair: PictureAndDisparity  # decoded reference
    rendered: tuple[Picture, ...]  # all views

    @property
    def rate_bpp(self) -> float:
        """Bits of the file per pixel of the reference."""
        return 8.0 * self.num_bytes / self.num_pixels

    @property
    def reference_bpp(self) -> float:
        """Bits of the reference view per pixel."""
        return 8.0 * self.picture_bytes / self.num_pixels

    @property
    def share(self) -> float:
        """Share of the disparities in the file."""
        return self.disparity_bytes / self.num_bytes


Curves = Mapping[str, Sequence[Point]]
"""Points by the name of the coder."""


def reference_multipliers(views: Views, rates_bpp: Sequence[float]) -> list[float]:
    """Return the multipliers for given rates of the reference view."""
    code = picture_codec.encode(views.pictures[views.references[0]])
    multipliers = []
    for rate in rates_bpp:
        num_bytes = rate * views.shape[0] * views.shape[1] / 8.0
        tried = multipliers_around([code], num_bytes)
        errors = [abs(np.log(max(code.bytes_at_multiplier(one), 1) / num_bytes)) for one in tried]
        multipliers.append(tried[int(np.argmin(errors))])
    return multipliers


def curve(
    views: Views,
    labels: DisparityLabels,
    coder: Coder,
    multipliers: Sequence[float],
    method: Method = Method.DEFAULT,
) -> list[Point]:
    """Measure a curve."""
    encoder = ViewEncoder(views, labels, coder.kind, codec=coder.codec)
    return [_point(views, encoder.encode(multiplier), coder, method) for multiplier in multipliers]


def layered_points(
    views: Views, labels: DisparityLabels, coder: Coder, multiplier: float, num_layers: int, method: Method
) -> list[Point]:
    """Measure a file with quality layers, cut after each of them."""
    encoded = ViewEncoder(views, labels, coder.kind, num_layers, codec=coder.codec).encode(multiplier)
    return [_point(views, encoded, coder, method, count) for count in range(1, num_layers + 1)]


def _point(
    views: Views, encoded: Encoded, coder: Coder, method: Method, num_layers: int | None = None
) -> Point:
    """Decode a file, and render all views from it."""
    stream = decode_stream(encoded.data)
    decoded = decode(stream, num_layers, codec=coder.codec)
    layers = stream.layers[: decoded.num_layers]
    picture, disparity = (sum(len(pair[part]) for layer in layers for pair in layer) for part in (0, 1))
    rendered = _rendered(views, decoded, method)
    return Point(
        encoded.multiplier,
        len(encoded.data) - sum(len(encode_layer(layer)) for layer in stream.layers[decoded.num_layers :]),
        views.shape[0] * views.shape[1],
        picture,
        disparity,
        quality_of(rendered, views.pictures),
        decoded.pairs[0],
        rendered,
    )


def _rendered(views: Views, decoded: Decoded, method: Method) -> tuple[Picture, ...]:
    coded = dict(zip(views.references, decoded.pairs, strict=True))
    pictures = []
    for index, viewpoint in enumerate(decoded.header.viewpoints):
        if index in coded:
            pictures.append(coded[index].picture)
        elif method is Method.THESIS:
            pictures.append(render_planes(decoded.pairs[0], viewpoint))
        else:
            pictures.append(picture_of(render(decoded, viewpoint)))
    return tuple(pictures)


def render_planes(pair: PictureAndDisparity, viewpoint: Viewpoint) -> Picture:
    """Render a view plane by plane from far to near, bilinear, with holes filled by the Poisson equation."""
    warp = warp_between(pair.viewpoint, viewpoint)
    shape = pair.picture.shape[1], pair.picture.shape[0]
    picture = pair.picture.astype(np.float32)
    rendered = np.zeros(pair.picture.shape, np.float64)
    covered = np.zeros(pair.picture.shape[:2], np.bool_)
    for disparity in np.unique(pair.disparity):
        homography = warp[:, :3].copy()
        homography[:, 2] += disparity * warp[:, 3]
        plane = (pair.disparity == disparity).astype(np.float32)
        mask = cv2.warpPerspective(plane, homography, shape, flags=cv2.INTER_LINEAR) >= 0.5
        rendered[mask] = cv2.warpPerspective(picture, homography, shape, flags=cv2.INTER_LINEAR)[mask]
        covered |= mask
    flat = np.where(covered, 0.0, EMPTY)
    filled = fill_from_background(rendered[..., None], flat, np.zeros(3))[0][..., 0]
    return np.clip(np.floor(filled + 0.5), 0.0, 255.0).astype(np.uint8)


def differences(points: Sequence[Point], anchor: Sequence[Point]) -> tuple[float, float] | None:
    """Return Bjontegaard differences in PSNR and rate of a curve from another one, if they overlap."""
    sides = [
        ([point.rate_bpp for point in side], [point.quality.pooled_db for point in side])
        for side in (anchor, points)
    ]
    try:
        return bd_psnr(*sides[0], *sides[1]).value, bd_rate(*sides[0], *sides[1]).value
    except RdCurveError:
        return None


def worst_loss(points: Sequence[Point], unlayered: Sequence[Point]) -> float | None:
    """Return the largest loss of PSNR by quality layers at equal rates."""
    rates = np.log([point.rate_bpp for point in (*points, *unlayered)])
    losses = _psnrs_at(unlayered, rates) - _psnrs_at(points, rates)
    return None if np.isnan(losses).all() else float(np.nanmax(losses))


def _psnrs_at(points: Sequence[Point], log_rates: Floats) -> Floats:
    """Interpolate a curve over the logarithm of the rate; NaN outside it."""
    ordered = sorted(points, key=lambda point: point.rate_bpp)
    rates = np.log([point.rate_bpp for point in ordered])
    psnrs = np.interp(log_rates, rates, [point.quality.pooled_db for point in ordered])
    inside = (rates[0] - 1e-9 <= log_rates) & (log_rates <= rates[-1] + 1e-9)
    return np.where(inside, psnrs, np.nan)
