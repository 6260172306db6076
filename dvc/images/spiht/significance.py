"""Significance maps: where decoded coefficients are not zero, scale by scale."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dvc.images.lifting import scale_shapes
from dvc.images.zerotree_coder import DecodedCoefficients
from dvc.images.zerotrees import Band, Shape


def significance_maps(
    bands: Sequence[Band], decoded: DecodedCoefficients, shape: Shape, num_levels: int
) -> list[NDArray[np.bool_]]:
    """Tell where any orientation of any plane has a significant coefficient."""
    maps = [np.zeros(size, np.bool_) for size in scale_shapes(shape, num_levels)[1:]]
    for band in bands:
        if 0 < band.level <= num_levels and band.kind:
            rows, columns = band.shape
            maps[band.level - 1][:rows, :columns] |= band.of(decoded.values) != 0
    for coarser in maps[max(band.level for band in bands) :]:
        coarser[:] = True
    return maps
