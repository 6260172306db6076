"""Random edges, and one step of the transform on each column of a plane by itself."""

import numpy as np

from dvc.images.edge_maps import EdgeMaps
from dvc.images.lifting import Details, Pyramid, Transform


def random_edges(rng, shape, share):
    """Return random edges; a share of all pairs of neighbours is separated."""
    below, right = ((rng.random(shape) < share).astype(np.uint8) for _ in range(2))
    below[-1:], right[:, -1:] = 0, 0
    return EdgeMaps(below, right)


def assert_same_edges(one, other):
    np.testing.assert_array_equal(one.between_rows, other.between_rows)
    np.testing.assert_array_equal(one.between_columns, other.between_columns)


def split(samples, name="9/7", cuts=None, order=0):
    """Return the low and the high band of columns, which may be cut below samples."""
    bands = []
    for t in range(samples.shape[1]):
        column = samples[:, t : t + 1]
        cut = np.zeros(column.shape, np.uint8) if cuts is None else cuts[:, t : t + 1]
        edges = EdgeMaps(cut, np.zeros_like(cut))
        pyramid = Transform(1, name, edges, order).analyse(column)
        bands.append((pyramid.low, pyramid.details[0].vertical))
    return tuple(np.hstack(band) for band in zip(*bands, strict=True))


def merge(low, high, name="9/7"):
    """Return the columns of both bands; the inverse of `split`."""
    columns = []
    for t in range(low.shape[1]):
        nothing = [np.zeros((len(band), 0)) for band in (low, high)]
        details = Details(nothing[0], high[:, t : t + 1], nothing[1])
        columns.append(Transform(1, name).synthesise(Pyramid(low[:, t : t + 1], (details,))))
    return np.hstack(columns)
