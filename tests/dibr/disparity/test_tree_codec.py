"""Search for the best tree: chosen by what rendering tells, at costs that rise with differences."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from dvc.dibr.disparity.disparity_codec import Holes, all_significant, subtract_hole_errors
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM, S_TRANSFORM, IntegerTransform
from dvc.dibr.disparity.tree_codec import Statistics, WaveletCodec, code_costs, encode_tree, kinds_of
from tests.reference.dibr_trees import analysed

SHAPE, NUM_LABELS, MULTIPLIER = (24, 30), 20, 1e-4


def noisy_tensor() -> NDArray[np.float32]:
    """Return the errors of two surfaces, with noise that suggests other labels here and there."""
    rng = np.random.default_rng(0)
    labels = np.where(np.arange(SHAPE[1]) < 14, 4, 15)
    errors = np.minimum(np.abs(labels[:, None] - np.arange(NUM_LABELS)) * 0.004, 0.01)
    return (errors + rng.uniform(0.0, 0.01, (*SHAPE, NUM_LABELS))).astype(np.float32)


class Rendered:
    """Views one label to the right per pixel of parallax: what is not reached is wrong by 0.02."""

    parallax = 0.5

    def __init__(self, tensor: NDArray[np.float32]) -> None:
        self.tensor = tensor

    def measure(self, labels: NDArray[np.int32]) -> tuple[float, list[Holes]]:
        """Return the error of a map, that of its holes with it."""
        reached = np.zeros(SHAPE, np.bool_)
        rows, columns = np.indices(SHAPE)
        inside = columns - labels >= 0
        reached[rows[inside], (columns - labels)[inside]] = True
        empty = np.where(reached, 0.0, 0.02).astype(np.float32)
        holes = Holes(empty, np.zeros(SHAPE, np.int32))
        error = float(np.take_along_axis(self.tensor, labels[:, :, None], 2).sum(dtype=np.float64))
        return error + float(empty.sum()), [holes]

    def claimed(
        self, tensor: NDArray[np.float32], holes: Sequence[Holes], weight: float
    ) -> NDArray[np.float32]:
        """Credit labels that cover holes."""
        warp = np.array([[1.0, 0.0, 0.0, -1.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
        return subtract_hole_errors(tensor, holes, [warp], np.arange(NUM_LABELS, dtype=np.float64), weight)


@pytest.mark.parametrize("transform", [L_TRANSFORM, S_TRANSFORM], ids=lambda one: one.name)
def test_maps_are_chosen_by_the_errors_that_they_cause(transform: IntegerTransform) -> None:
    tensor, codec = noisy_tensor(), WaveletCodec(transform)
    rendered = Rendered(tensor)
    trees = codec.optimise(tensor, MULTIPLIER), codec.optimise(tensor, MULTIPLIER, distortion=rendered)
    plain, chosen = (rendered.measure(tree.disparity()) for tree in trees)
    spent = [MULTIPLIER * 8 * len(codec.encode(tree)) for tree in trees]
    assert chosen[0] + spent[1] < 0.98 * (plain[0] + spent[0])
    assert chosen[1][0].errors.sum() < plain[1][0].errors.sum()


def test_labels_that_would_cover_a_hole_are_credited() -> None:
    rng = np.random.default_rng(1)
    tensor = rng.uniform(size=(6, 9, 4)).astype(np.float32)
    hole = np.zeros((6, 9), np.float32)
    hole[2, 5] = 0.5
    warp = np.array([[1.0, 0.0, 0.0, -1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]])
    first_label = np.full(hole.shape, 1, np.int32)
    holes = [Holes(hole, first_label), Holes(np.zeros_like(hole), first_label)]
    found = subtract_hole_errors(tensor, holes, [warp] * 2, np.arange(4.0), 0.3)
    expected = tensor.copy()
    for label in range(1, 3):  # from (5 + d, 2 - d); label 0 would be hidden
        expected[2 - label, 5 + label, label] -= np.float32(0.3 / 3) * hole[2, 5]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_holes_of_slanted_planes_are_credited_where_they_were_seen_from() -> None:
    hole = np.zeros((40, 50), np.float32)
    hole[17, 31] = 1.0
    warp = np.array([[1.1, 0.05, -2.0, 3.0], [-0.04, 0.97, 1.0, 0.5], [1e-4, 2e-4, 1.0, 0.0]])
    holes = [Holes(hole, np.zeros(hole.shape, np.int32))]
    found = subtract_hole_errors(
        np.zeros((40, 50, 2), np.float32), holes, [2.0 * warp], np.array([0.0, -2.0]), 1.0
    )
    for label, inverse_depth in enumerate((0.0, -2.0)):
        ((row, column),) = np.argwhere(found[..., label])
        x, y, z = warp @ [column, row, 1.0, inverse_depth]
        assert abs(x / z - 31.0) < 0.6
        assert abs(y / z - 17.0) < 0.6


def test_costs_of_the_code_are_near_its_length() -> None:
    """What the costs say of a tree that was coded is what it took, within 15 %."""
    tensor = noisy_tensor()
    tree = WaveletCodec(L_TRANSFORM).optimise(tensor, MULTIPLIER)
    classes = all_significant(SHAPE)
    payload, statistics = encode_tree(tree, classes)
    costs = code_costs(1.0, NUM_LABELS, statistics, kinds_of(tree, classes))
    bits = 0.0
    for level, cost in enumerate(costs):
        flags = statistics.flags[level]
        bits += float((flags * np.where(flags > 0, cost.flags, 0.0)).sum())
        counts = statistics.coefficients[level]
        used = counts[:, 0] > 0
        bits += float((counts[used, 0] * cost.coefficients[used, 0]).sum())
        for c in range(2):
            used = counts[:, 2 + c] > 0
            bits += float((counts[used, 2 + c] * cost.merges[used, c]).sum())
        used = counts[:, 6] > 0
        rest = cost.coefficients[used, 1] + cost.coefficients[used, 2]
        bits += float((counts[used, 6] * rest + counts[used, 7] * cost.coefficients[used, 2]).sum())
    assert bits == pytest.approx(8 * len(payload), rel=0.15)


def test_tears_make_differences_dearer() -> None:
    labels = np.arange(720, dtype=np.int32).reshape(SHAPE) % NUM_LABELS
    tree = analysed(L_TRANSFORM, labels, NUM_LABELS)
    kinds = kinds_of(tree, all_significant(SHAPE))
    plain = code_costs(MULTIPLIER, NUM_LABELS, Statistics.none(len(kinds)), kinds)
    torn = code_costs(MULTIPLIER, NUM_LABELS, Statistics.none(len(kinds)), kinds, 0.02)
    for level, (before, after) in enumerate(zip(plain, torn, strict=True)):
        np.testing.assert_array_equal(before.coefficients[:, 4], 0.0)
        np.testing.assert_allclose(after.coefficients[:, 4], 0.02 * 2**level, rtol=1e-6)
        np.testing.assert_array_equal(after.coefficients[:, :4], before.coefficients[:, :4])
        np.testing.assert_array_equal(after.merges, before.merges)
