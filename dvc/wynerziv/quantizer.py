"""Scalar quantisers of the bands, of two kinds.

*Range*, the presets of the literature: a band with ``levels`` = 2^m levels makes m bit planes. DC has
``levels`` bins on [0, 1024). AC has ``levels - 1`` bins, symmetric about zero: the zero bin is (-step, step),
the others are one step wide and the outermost ends at ``levels / 2`` steps. The step follows from the band's
largest magnitude in the frame and is sent as an index on a logarithmic scale.

*Nested*: all bins of all bands of a frame have one width; a band has as many planes as its values need. Each
plane halves the bins of those before it, so that bins of 2, 4, 8 ... steps are the quantisers of a decoder
that leaves the last planes out. DC begins at zero. In AC bands zero lies one third or two thirds into its
bin at every depth, since 4^n / 3 = 1/3 modulo 1: it is never close to a border, where it would cost bits.
"""

import math

import numpy as np
from numpy.typing import NDArray

from dvc.config.sections import MAX_BAND_PLANES, NUM_BANDS
from dvc.wynerziv import _kernels

DC_RANGE = 1024.0
STEP_INDEX_BITS = 6
_STEPS_PER_OCTAVE = 6
_IN_OCTAVE = (
    1.0,
    1.122462048309373,
    1.2599210498948732,
    1.4142135623730951,
    1.5874010519681996,
    1.7817974362806785,
)
"""Powers of two, written down: those of C libraries differ in their last digits."""
_MAX_STEP_INDEX = (1 << STEP_INDEX_BITS) - 1


def step_from_index(index: int) -> float:
    """Return the step that an index stands for; inverse of `index_of_step`."""
    return math.ldexp(_IN_OCTAVE[index % _STEPS_PER_OCTAVE], index // _STEPS_PER_OCTAVE)


def index_of_step(step: float) -> int:
    """Return the index of the least step that is not below one."""
    index = math.ceil(_STEPS_PER_OCTAVE * math.log2(max(step, 1.0)) - 1e-9)
    return min(index, _MAX_STEP_INDEX)


def step_index(coefficients: NDArray[np.float64], levels: int) -> int:
    """Return the index of the step of an AC band: 2 |x|max / (levels - 1), as in DISCOVER, rounded up."""
    max_magnitude = float(np.abs(coefficients).max(initial=0.0))
    return index_of_step(2.0 * max_magnitude / (levels - 1))


def bin_edges(levels: int, step: float | None) -> NDArray[np.float64]:
    """Return the borders of the bins of a range quantiser, in increasing order."""
    if step is None:
        return np.arange(levels + 1, dtype=np.float64) * (DC_RANGE / levels)
    positive = np.arange(1, levels // 2 + 1) * step
    edges: NDArray[np.float64] = np.concatenate([-positive[::-1], positive])
    return edges


def embedded_origin(band: int, planes: int) -> float:
    """Return where zero lies among embedded bins."""
    return 0.0 if band == 0 else 4 ** (-(-planes // 2)) / 3


def embedded_edges(band: int, planes: int, step: float) -> NDArray[np.float64]:
    """Return the borders of embedded bins, in increasing order."""
    numbers = np.arange((1 << planes) + 1, dtype=np.float64)
    return (numbers - embedded_origin(band, planes)) * step


_ORIGINS = np.array(
    [[embedded_origin(band, planes) for planes in range(MAX_BAND_PLANES + 1)] for band in range(NUM_BANDS)]
)


def embedded_planes(extremes: NDArray[np.float64], step: float) -> NDArray[np.int64]:
    """Return how many planes hold all values of each band in embedded bins."""
    planes = np.empty(NUM_BANDS, np.int64)
    _kernels.count_planes(extremes, _ORIGINS, step, planes)
    return planes


def embedded_origins(planes: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return `embedded_origin` of all bands."""
    return _ORIGINS[np.arange(NUM_BANDS), planes]
