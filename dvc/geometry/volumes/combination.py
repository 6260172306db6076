"""Combination of the costs of several views: of opposite ones, and of rows and columns of an array."""

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.volumes import _kernels
from dvc.geometry.volumes.matching_costs import WeightedCosts


def smaller_costs(first: WeightedCosts, second: WeightedCosts) -> WeightedCosts:
    """Take the smaller cost of two views on opposite sides: one of them sees the point (2.18)."""
    _kernels.keep_smaller(*first, *second)
    return first


def mean_costs(first: WeightedCosts, second: WeightedCosts) -> WeightedCosts:
    """Take the weighted mean of two costs (2.20)."""
    _kernels.keep_mean(*first, *second)
    return first


def defined_costs(costs: WeightedCosts, constant: float, share: float) -> NDArray[np.float32]:
    """Fill what is not known with a constant."""
    _kernels.fill_undefined(*costs, np.float32(constant), np.float32(share))
    return costs.cost
