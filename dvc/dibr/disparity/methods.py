"""Ways to represent a disparity map, by name."""

from dvc.dibr.disparity.blocks import BlockCodec
from dvc.dibr.disparity.disparity_codec import DisparityCodec
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM, S_TRANSFORM
from dvc.dibr.disparity.quadtree import QuadtreeCodec
from dvc.dibr.disparity.wavelet_codec import WaveletCodec

METHODS: dict[str, DisparityCodec] = {
    "l": WaveletCodec(L_TRANSFORM),
    "s": WaveletCodec(S_TRANSFORM),
    "quadtree": QuadtreeCodec(),
    "blocks": BlockCodec(),
}
"""Codecs by the name that options have for them."""
