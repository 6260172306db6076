"""Chapter 3 as it is written: its codecs and its rendering, and what its text leaves open."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.thesis.chapter import Way
from dvc.dibr.disparity.blocks import BlockCodec
from dvc.dibr.disparity.disparity_codec import DisparityCodec
from dvc.dibr.disparity.fixed_quadtree import FixedQuadtreeCodec
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM, S_TRANSFORM
from dvc.dibr.disparity.laplacian_codec import LaplacianCodec
from dvc.dibr.disparity.methods import METHODS
from dvc.dibr.disparity.quadtree import QuadtreeCodec
from dvc.dibr.rendering import PictureAndDisparity
from dvc.geometry.hole_filling import poisson_filled
from dvc.geometry.viewpoints import Viewpoint, warp_between
from dvc.images.colour import Picture

PLAIN_QUADTREE = "quadtree without credits"
"""Ours beside the quadtree that is searched as L and S are."""


@dataclass(frozen=True)
class Method:
    """A way to code disparities, and the kind of stream that it is written as."""

    kind: str
    codec: DisparityCodec


METHODS_BY_WAY: Mapping[Way, Mapping[str, Method]] = {
    Way.THESIS: {
        "l": Method("l", LaplacianCodec(L_TRANSFORM)),
        "s": Method("s", LaplacianCodec(S_TRANSFORM)),
        "quadtree": Method("quadtree", FixedQuadtreeCodec()),
        "blocks": Method("blocks", BlockCodec()),
    },
    Way.OURS: {
        **{name: Method(name, codec) for name, codec in METHODS.own.items()},
        "quadtree": Method("quadtree", QuadtreeCodec(has_credits=True)),
        PLAIN_QUADTREE: Method("quadtree", QuadtreeCodec()),
    },
}
"""Ways to code disparities by name; as written none of them knows what is rendered."""


def render_planes(pair: PictureAndDisparity, viewpoint: Viewpoint) -> Picture:
    """Render a view: plane by plane, the farthest first, bilinear, holes filled by the Poisson equation."""
    warp = warp_between(pair.viewpoint, viewpoint)
    shape = pair.picture.shape[1], pair.picture.shape[0]
    picture = pair.picture.astype(np.float32)
    found = np.zeros(pair.picture.shape, np.float64)
    drawn = np.zeros(pair.picture.shape[:2], np.bool_)
    for disparity in np.unique(pair.disparity):
        homography = warp[:, :3].copy()
        homography[:, 2] += disparity * warp[:, 3]
        mask = (pair.disparity == disparity).astype(np.float32)
        moved = _moved(mask, homography, shape) >= 0.5
        found[moved] = _moved(picture, homography, shape)[moved]
        drawn |= moved
    filled = poisson_filled(found[..., None], ~drawn)[..., 0]
    return np.clip(np.floor(filled + 0.5), 0.0, 255.0).astype(np.uint8)


def _moved(
    plane: NDArray[np.float32], homography: NDArray[np.float64], shape: tuple[int, int]
) -> NDArray[np.float32]:
    return np.asarray(cv2.warpPerspective(plane, homography, shape, flags=cv2.INTER_LINEAR), np.float32)


READINGS = (
    "lambda is a squared error of a pixel, intensities from 0 to 1, for a bit; the errors of (3.31) "
    "are means over "
    "all views. Pixels outside a view do not count.",
    "The search for b ends where lambda is met to 1 %; b is at least 0.05. Contexts of the "
    "arithmetic coder of "
    "magnitudes are one set for all scales; significance of a node is that of any orientation of the "
    "reference.",
    "The coding of quadtrees is not told: a bit for each split and labels of fixed length, as those "
    "of blocks; "
    "the best tree for these codes. Ours has adaptive contexts.",
    "As written, trees are the best for backward errors (3.31); nothing is known of what rendering "
    "makes of them.",
    "Views are rendered from the decoded file, and all of them count, the reference too. Gains "
    "between methods "
    "are Bjontegaard differences at the same lambdas, those at which the reference has 0.1 to 1 bit "
    "per pixel.",
    "The reference view is coded by a SPIHT coder of this project, not by that of QccPack.",
    "Streams are those of this project: their header, lengths and checksums count.",
)
