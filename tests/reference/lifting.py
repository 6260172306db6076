"""Lifting of whole planes without edges, by slices of arrays."""

import numpy as np

from dvc.images.lifting import WAVELETS, Details, Pyramid


def analyse(plane, num_levels, name="9/7"):
    """Return the pyramid of a plane."""
    low, details = np.array(plane, np.float64), []
    for _ in range(num_levels):
        top, bottom = _split(low, name)
        low, horizontal = (half.T for half in _split(top.T, name))
        vertical, diagonal = (half.T for half in _split(bottom.T, name))
        details.append(Details(horizontal, vertical, diagonal))
    return Pyramid(low, tuple(details))


def _split(samples, name):
    even, odd = samples[0::2].copy(), samples[1::2].copy()
    if not len(odd):
        return even, odd
    for step, weight in enumerate(WAVELETS[name].weights):
        if step % 2 == 0:
            odd += weight * (even[: len(odd)] + np.concatenate([even[1:], even[-1:]])[: len(odd)])
        else:
            before = np.concatenate([odd[:1], odd])[: len(even)]
            even += weight * (before + np.concatenate([odd, odd[-1:]])[: len(even)])
    low, high = WAVELETS[name].scales
    return even * low, odd * high
