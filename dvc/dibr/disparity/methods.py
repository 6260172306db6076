"""Ways to represent a disparity map, by name."""

from functools import partial

from dvc.dibr.disparity.blocks import BlockCodec
from dvc.dibr.disparity.disparity_codec import DisparityCodec
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM, S_TRANSFORM
from dvc.dibr.disparity.square_codecs import QuadtreeCodec
from dvc.dibr.disparity.tree_codec import WaveletCodec
from dvc.extensions import DISPARITY_CODECS, Registry, make

METHODS: Registry[DisparityCodec] = Registry(
    DISPARITY_CODECS,
    {
        "l": WaveletCodec(L_TRANSFORM),
        "s": WaveletCodec(S_TRANSFORM),
        "quadtree": QuadtreeCodec(),
        "blocks": BlockCodec(),
    },
    partial(make, DISPARITY_CODECS),
)
"""By the name that options have for them; those of other packages are made when they are asked for."""
