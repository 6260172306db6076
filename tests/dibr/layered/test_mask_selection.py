"""Masks of the largest profit, against all masks; what is left out and closed."""

import numpy as np
import pytest

from dvc.dibr.layered.mask_selection import best_mask


def profit_of(mask: np.ndarray, profit: np.ndarray, edge_cost: float) -> float:
    edges = np.count_nonzero(mask[1:] != mask[:-1]) + np.count_nonzero(mask[:, 1:] != mask[:, :-1])
    return float(profit[mask].sum() - edge_cost * edges)


@pytest.mark.parametrize("seed", range(5))
def test_no_mask_pays_more(seed: int) -> None:
    """All 4096 masks of 3 x 4 pixels."""
    profit = np.random.default_rng(seed).normal(0.2, 2.0, (3, 4))
    found = best_mask(profit, 0.7, 0.0)
    masks = (np.arange(1 << 12)[:, None] >> np.arange(12) & 1).astype(np.bool_).reshape(-1, 3, 4)
    best = max(profit_of(mask, profit, 0.7) for mask in masks)
    assert profit_of(found, profit, 0.7) == pytest.approx(best, abs=0.2)  # capacities are rounded


def test_specks_are_left_out_and_pinholes_closed() -> None:
    profit = np.full((20, 30), -0.5)
    profit[4:14, 5:20] = 3.0
    profit[8, 9] = -0.5
    profit[17, 25] = 3.0
    found = best_mask(profit, 1.0, 0.0)
    assert found[8, 9]
    assert not found[17, 25]
    assert found.sum() == 150
    assert not best_mask(profit, 1.0, 1000.0).any()


def test_what_cannot_be_inside_is_not() -> None:
    profit = np.full((6, 6), 5.0)
    profit[2] = -np.inf
    assert not best_mask(profit, 1.0, 0.0)[2].any()
    assert best_mask(profit, 1.0, 0.0).sum() == 30
    assert not best_mask(-np.abs(profit), 1.0, 0.0).any()
