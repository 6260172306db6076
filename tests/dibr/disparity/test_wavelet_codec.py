"""Search for the best tree: chosen by what rendering tells, at costs that rise with differences."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dvc.dibr.disparity.coding import all_significant, encode_tree, no_statistics
from dvc.dibr.disparity.distortion import backward_error
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM, S_TRANSFORM, IntegerTransform, WaveletTree
from dvc.dibr.disparity.rate_model import code_costs, kinds_of
from dvc.dibr.disparity.wavelet_codec import WaveletCodec

SHAPE, NUM_LABELS, SLOPE = (24, 30), 20, 1e-4


def noisy_tensor() -> NDArray[np.float32]:
    """Return the errors of two surfaces, with noise that suggests other labels here and there."""
    rng = np.random.default_rng(0)
    labels = np.where(np.arange(SHAPE[1]) < 14, 4, 15)
    errors = np.minimum(np.abs(labels[:, None] - np.arange(NUM_LABELS)) * 0.004, 0.01)
    return (errors + rng.uniform(0.0, 0.01, (*SHAPE, NUM_LABELS))).astype(np.float32)


def holes(labels: NDArray[np.int32]) -> float:
    """Return how far neighbours in a row are apart, which is where other views have holes."""
    return float(np.abs(np.diff(labels, axis=1)).sum())


@pytest.mark.parametrize("transform", [L_TRANSFORM, S_TRANSFORM], ids=lambda one: one.name)
def test_maps_are_chosen_by_the_errors_that_they_cause(transform: IntegerTransform) -> None:
    """Told that holes are errors, the codec finds a map of fewer holes, and of less cost in all."""
    tensor, codec = noisy_tensor(), WaveletCodec(transform)

    def distortion(labels: NDArray[np.int32]) -> float:
        return backward_error(tensor, labels) + 0.01 * holes(labels)

    plain = codec.optimise(tensor, SLOPE)
    smooth = codec.optimise(tensor, SLOPE, distortion=distortion)
    costs = [distortion(tree.disparity()) + SLOPE * 8 * len(codec.encode(tree)) for tree in (plain, smooth)]
    assert costs[1] < 0.9 * costs[0]
    assert holes(smooth.disparity()) < 0.7 * holes(plain.disparity())


def test_costs_of_the_code_are_near_its_length() -> None:
    """What the costs say of a tree that was coded is what it took, within 15 %."""
    tensor = noisy_tensor()
    tree = WaveletCodec(L_TRANSFORM).optimise(tensor, SLOPE)
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


def test_smoothness_makes_differences_dearer() -> None:
    """With smoothness a coefficient costs more by it for each label, and neighbours are no help."""
    tree = WaveletTree.of_labels(
        L_TRANSFORM, np.arange(720, dtype=np.int32).reshape(SHAPE) % NUM_LABELS, NUM_LABELS
    )
    kinds = kinds_of(tree, all_significant(SHAPE))
    plain = code_costs(SLOPE, NUM_LABELS, no_statistics(len(kinds)), kinds)[0]
    smooth = code_costs(SLOPE, NUM_LABELS, no_statistics(len(kinds)), kinds, 0.02)[0]
    significant = slice(5, None)
    np.testing.assert_allclose(
        smooth.coefficients[significant, 2], plain.coefficients[significant, 2] + np.float32(0.02), rtol=1e-5
    )
    assert np.isinf(smooth.merges).all()
    assert np.isinf(smooth.coefficients[:, 3]).all()
