"""Lifting of columns that edges cut into segments, compiled."""

import numpy as np
from numpy.typing import NDArray

from dvc._jit import kernel

Plane = NDArray[np.float64]
Flags = NDArray[np.uint8]

EXTRAPOLATION = np.array(
    [[1.0, 0.0, 0.0, 0.0], [2.0, -1.0, 0.0, 0.0], [3.0, -3.0, 1.0, 0.0], [4.0, -6.0, 4.0, -1.0]]
)
"""Weights of (4.4) for polynomials of degrees 0 to 3."""


@kernel
def lift_columns(
    samples: Plane, edges: Flags, weights: Plane, gain: float, order: int, inverse: bool
) -> None:
    """Apply the lifting steps of a wavelet to columns in place, (4.1) and (4.2), not across edges."""
    num_steps = len(weights)
    for k in range(num_steps):
        step = num_steps - 1 - k if inverse else k
        weight = -weights[step] if inverse else weights[step]
        if step % 2 == 0:
            _predict(samples, edges, weight, order)
        else:
            _update(samples, edges, weight, order, order > 0 and step == num_steps - 1)
            if step == 1:
                _scale_lone(samples, edges, 1.0 / gain if inverse else gain)


@kernel
def _predict(samples: Plane, edges: Flags, weight: float, order: int) -> None:
    """Change odd samples. One that is alone between edges is predicted from beyond them."""
    num_rows, num_columns = samples.shape
    last = num_rows - 1
    for i in range(1, num_rows, 2):
        for t in range(num_columns):
            cut_before = edges[i - 1, t] != 0
            cut_after = i < last and edges[i, t] != 0
            if cut_before and (cut_after or i == last):
                before = samples[i - 1, t]
                after = samples[i + 1, t] if i < last else before
            else:
                before = _beyond(samples, edges, i, t, -1, order) if cut_before else samples[i - 1, t]
                if i == last:
                    after = samples[i - 1, t]
                else:
                    after = _beyond(samples, edges, i, t, 1, order) if cut_after else samples[i + 1, t]
            samples[i, t] += weight * (before + after)


@kernel
def _update(samples: Plane, edges: Flags, weight: float, order: int, final: bool) -> None:
    """Change even samples; with `final`, details beyond an edge are taken to be zero."""
    num_rows, num_columns = samples.shape
    last = num_rows - 1
    for i in range(0, num_rows, 2):
        for t in range(num_columns):
            cut_before = i > 0 and edges[i - 1, t] != 0
            cut_after = i < last and edges[i, t] != 0
            if (cut_before or i == 0) and (cut_after or i == last):
                continue
            before, after = 0.0, 0.0
            if i == 0:
                before = samples[i + 1, t]
            elif not cut_before:
                before = samples[i - 1, t]
            elif not final:
                before = _beyond(samples, edges, i, t, -1, order)
            if i == last:
                after = samples[i - 1, t]
            elif not cut_after:
                after = samples[i + 1, t]
            elif not final:
                after = _beyond(samples, edges, i, t, 1, order)
            samples[i, t] += weight * (before + after)


@kernel
def _scale_lone(samples: Plane, edges: Flags, factor: float) -> None:
    """Scale even samples that are alone between edges as constant signals are."""
    num_rows, num_columns = samples.shape
    last = num_rows - 1
    for i in range(0, num_rows, 2):
        for t in range(num_columns):
            if (i == 0 or edges[i - 1, t] != 0) and (i == last or edges[i, t] != 0):
                samples[i, t] *= factor


@kernel
def _beyond(samples: Plane, edges: Flags, i: int, t: int, way: int, order: int) -> float:
    """Extrapolate the sample beyond the edge next to sample i from those of its coset on this side (4.4)."""
    num_rows = samples.shape[0]
    available = 0
    k = i
    while available <= order:
        k -= way
        if k < 0 or k >= num_rows or edges[min(k, k + way), t] != 0:
            break
        if (i - k) % 2 != 0:
            available += 1
    total = 0.0
    for m in range(available):
        total += EXTRAPOLATION[available - 1, m] * samples[i - way * (2 * m + 1), t]
    return float(total)
