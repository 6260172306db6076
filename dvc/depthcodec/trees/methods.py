"""Ways to represent a disparity map, by name."""

from dvc.depthcodec.trees.blocks import BlockCodec
from dvc.depthcodec.trees.disparity_codec import DisparityCodec
from dvc.depthcodec.trees.integer_transforms import L_TRANSFORM, S_TRANSFORM
from dvc.depthcodec.trees.quadtree import QuadtreeCodec
from dvc.depthcodec.trees.wavelet_codec import WaveletCodec

METHODS: dict[str, DisparityCodec] = {
    "l": WaveletCodec(L_TRANSFORM),
    "s": WaveletCodec(S_TRANSFORM),
    "quadtree": QuadtreeCodec(),
    "blocks": BlockCodec(),
}
"""By the name that options have for them."""
