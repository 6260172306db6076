"""Points of rate-distortion curves, measured on what a decoder makes of the file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.baselines.quality import Quality, quality_of
from benchmarks.thesis.chapter import Way
from benchmarks.thesis.chapter3.as_written import Method, render_planes
from dvc.dibr.disparity.disparity_codec import DisparityCodec
from dvc.dibr.rendering import PictureAndDisparity, picture_of, render
from dvc.dibr.views.decoder import Decoded, decode
from dvc.dibr.views.encoder import Encoded, ViewEncoder
from dvc.dibr.views.stream import Stream, decode_stream
from dvc.dibr.views.views import Views
from dvc.errors import RdCurveError
from dvc.geometry.camera_array import DisparityLabels
from dvc.images import codec as picture_codec
from dvc.images.codec import PictureCode, multipliers_around
from dvc.images.colour import Picture
from dvc.metrics import bd_psnr, bd_rate


@dataclass(frozen=True, eq=False)
class Point:
    """One file, decoded, and all views rendered from it."""

    multiplier: float  # squared error, intensities from 0 to 1, that the last bit of a pixel was worth
    num_bytes: int  # of the file, or of its first layers
    num_pixels: int  # of the reference
    picture_bytes: int  # parts of it
    disparity_bytes: int
    quality: Quality  # PSNR of all views
    pair: PictureAndDisparity  # what was decoded
    rendered: tuple[Picture, ...]  # all views

    @property
    def rate_bpp(self) -> float:
        """Bits of the file over pixels of the reference."""
        return 8.0 * self.num_bytes / self.num_pixels

    @property
    def reference_bpp(self) -> float:
        """Bits of the reference view over its pixels."""
        return 8.0 * self.picture_bytes / self.num_pixels

    @property
    def share(self) -> float:
        """Share of the disparities in the file."""
        return self.disparity_bytes / self.num_bytes


def reference_multipliers(views: Views, rates_bpp: Sequence[float]) -> list[float]:
    """Return the multipliers at which the reference view takes given rates."""
    code = picture_codec.encode(views.pictures[views.references[0]])
    num_pixels = views.shape[0] * views.shape[1]
    return [_multiplier_of(code, rate * num_pixels / 8.0) for rate in rates_bpp]


def _multiplier_of(code: PictureCode, num_bytes: float) -> float:
    multipliers = multipliers_around([code], num_bytes)
    return min(
        multipliers,
        key=lambda multiplier: abs(np.log(max(code.bytes_at_multiplier(multiplier), 1) / num_bytes)),
    )


def measure(
    views: Views, encoded: Encoded, codec: DisparityCodec, way: Way = Way.OURS, num_layers: int | None = None
) -> Point:
    """Decode a file, and render all views from it."""
    stream = decode_stream(encoded.data)
    decoded = decode(stream, num_layers, codec=codec)
    layers = stream.layers[: decoded.num_layers]
    picture, disparity = (sum(len(pair[part]) for layer in layers for pair in layer) for part in (0, 1))
    rendered = rendered_views(views, decoded, way)
    return Point(
        encoded.multiplier,
        len(encoded.data) - _bytes_after(stream, decoded.num_layers),
        views.shape[0] * views.shape[1],
        picture,
        disparity,
        quality_of(rendered, views.pictures),
        decoded.pairs[0],
        rendered,
    )


def rendered_views(views: Views, decoded: Decoded, way: Way) -> tuple[Picture, ...]:
    """Render all views from a decoded file."""
    own = dict(zip(views.references, decoded.pairs, strict=True))
    return tuple(
        own[index].picture
        if index in own
        else render_planes(decoded.pairs[0], viewpoint)
        if way is Way.THESIS
        else picture_of(render(decoded, viewpoint))
        for index, viewpoint in enumerate(decoded.header.viewpoints)
    )


def _bytes_after(stream: Stream, num_layers: int) -> int:
    from dvc.dibr.views.stream import encode_layer

    return sum(len(encode_layer(layer)) for layer in stream.layers[num_layers:])


def curve(
    views: Views,
    labels: DisparityLabels,
    method: Method,
    multipliers: Sequence[float],
    way: Way = Way.OURS,
) -> list[Point]:
    """Measure a curve."""
    encoder = ViewEncoder(views, labels, method.kind, codec=method.codec)
    return [measure(views, encoder.encode(multiplier), method.codec, way) for multiplier in multipliers]


def layered_points(
    views: Views, labels: DisparityLabels, method: Method, multiplier: float, num_layers: int, way: Way
) -> list[Point]:
    """Measure a file with quality layers, cut after each of them."""
    encoded = ViewEncoder(views, labels, method.kind, num_layers, codec=method.codec).encode(multiplier)
    return [measure(views, encoded, method.codec, way, count) for count in range(1, num_layers + 1)]


def psnr_at(points: Sequence[Point], rate_bpp: float) -> float | None:
    """Interpolate a curve over the logarithm of the rate."""
    ordered = sorted(points, key=lambda point: point.rate_bpp)
    rates, psnrs = np.log([point.rate_bpp for point in ordered]), [p.quality.pooled_db for p in ordered]
    inside = rates[0] - 1e-9 <= np.log(rate_bpp) <= rates[-1] + 1e-9
    return float(np.interp(np.log(rate_bpp), rates, psnrs)) if inside else None


def differences(points: Sequence[Point], anchor: Sequence[Point]) -> tuple[float, float] | None:
    """Return Bjontegaard differences of a curve against another one."""
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
    rates = [point.rate_bpp for point in (*points, *unlayered)]
    both = [(psnr_at(unlayered, rate), psnr_at(points, rate)) for rate in rates]
    losses = [single - several for single, several in both if single is not None and several is not None]
    return max(losses) if losses else None


Curves = Mapping[str, Sequence[Point]]
"""By the name of the method."""
