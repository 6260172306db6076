"""Decomposition to one pixel against stopping earlier, as image coding does."""

from dvc.dibr.codec.decoder import PictureAndDisparity, significance_classes
from dvc.dibr.codec.encoder import ViewEncoder
from dvc.dibr.codec.rendering import picture_of, render_pairs
from dvc.dibr.codec.views import Views
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM
from dvc.dibr.disparity.wavelet_codec import WaveletCodec
from dvc.dibr.peers.quality import quality_of
from dvc.dibr.reference import codec as reference_codec
from dvc.dibr.reference.header import ReferenceHeader
from dvc.dibr.stream.layers import decode_stream
from dvc.dibr.thesis.curves import Point
from dvc.multiview.camera_array import DisparityLabels


def stopped_early(views: Views, labels: DisparityLabels, multiplier: float, num_levels: int | None) -> Point:
    """Encode by the L transform with few levels, decode, and render all views."""
    codec = WaveletCodec(L_TRANSFORM, num_levels)
    encoder = ViewEncoder(views, labels)
    encoder.codec = codec
    encoded = encoder.encode(multiplier)
    part = decode_stream(encoded.data).layers[0][0]
    header = ReferenceHeader.from_bytes(part.picture)
    decoded = reference_codec.decode(header, part.picture[ReferenceHeader.SIZE :], views.shape)
    classes = significance_classes(decoded)
    found = codec.decode(part.disparity, views.shape, labels.num_labels, classes)
    own = views.references[0]
    disparity = encoder.header.labels.disparity(found.disparity().astype(float))
    pair = PictureAndDisparity(decoded.picture(), disparity, views.viewpoints[own])
    rendered = tuple(
        pair.picture if index == own else picture_of(render_pairs([pair], viewpoint, labels.step))
        for index, viewpoint in enumerate(views.viewpoints)
    )
    num_pixels = views.shape[0] * views.shape[1]
    quality = quality_of(rendered, views.pictures)
    sizes = len(part.picture), len(part.disparity)
    return Point(multiplier, len(encoded.data), num_pixels, *sizes, quality, pair, rendered)
