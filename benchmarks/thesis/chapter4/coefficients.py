"""Figure 4.6: absolute values of the coefficients of a map by both transforms, and their entropies."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dvc.dibr.depth_image.depth_codes import DepthOptions
from dvc.dibr.depth_image.depth_scale import Plane
from dvc.images.wavelets.edge_maps import EdgeMaps
from dvc.images.wavelets.lifting import Pyramid, Transform, most_levels

STEP = 1 / 64
"""Of the quantiser whose output has the entropy, in parts of the range of the map."""


class HighBands(NamedTuple):
    """The high bands of a map."""

    # absolute coefficients where bands are usually drawn, the coarsest at the top left; the low band is 0
    absolute: Plane
    entropy_bpp: float  # of the quantised high bands, each by itself, in bits per pixel of the map
    nonzero_share: float  # of the coefficients of high bands that are not quantised to zero


def high_bands(depth: Plane, edges: EdgeMaps | None = None) -> HighBands:
    """Transform a map as the encoder does."""
    num_levels = min(DepthOptions.num_levels, most_levels((depth.shape[0], depth.shape[1])))
    pyramid = Transform(num_levels, DepthOptions.wavelet, edges, DepthOptions.order).analyse(depth)
    step = STEP * float(np.ptp(depth))
    bits, num_nonzero, num_high = 0.0, 0, 0
    for details in pyramid.details:
        for band in details.bands:
            quantised = np.fix(band / step).astype(np.int64)
            bits += band.size * _entropy(quantised)
            num_nonzero += int(np.count_nonzero(quantised))
            num_high += band.size
    return HighBands(np.abs(_drawn(pyramid, depth.shape)), bits / depth.size, num_nonzero / max(num_high, 1))


def _entropy(symbols: NDArray[np.int64]) -> float:
    """Bits per symbol of a band by itself."""
    if not symbols.size:
        return 0.0
    _, counts = np.unique(symbols, return_counts=True)
    shares = counts / symbols.size
    return float(-np.sum(shares * np.log2(shares)))


def _drawn(pyramid: Pyramid, shape: tuple[int, ...]) -> Plane:
    canvas = np.zeros(shape)
    for details in pyramid.details:
        height, width = details.vertical.shape[0], details.horizontal.shape[1]
        rows, columns = details.horizontal.shape[0], details.vertical.shape[1]
        canvas[:rows, columns : columns + width] = details.horizontal
        canvas[rows : rows + height, :columns] = details.vertical
        canvas[rows : rows + height, columns : columns + width] = details.diagonal
    canvas[: pyramid.low.shape[0], : pyramid.low.shape[1]] = 0.0
    return canvas
