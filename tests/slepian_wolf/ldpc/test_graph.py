"""Syndromes: the sums of the graph, whatever the planes and lengths."""

import numpy as np
import pytest

from dvc._jit import python_twin
from dvc.slepian_wolf.ldpc import _kernels
from dvc.slepian_wolf.ldpc.graph import SyndromeGraph, bit_orders, block_code, syndrome

pytestmark = pytest.mark.nojit


def random_words(num_planes: int, num_bits: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.integers(0, 2**64, (-(-num_planes // 64), num_bits), dtype=np.uint64)


def plane_of(words: np.ndarray, plane: int) -> np.ndarray:
    return (words[plane // 64] >> np.uint64(63 - plane % 64)) & np.uint64(1)


@pytest.mark.parametrize(
    ("planes", "num_checks"),
    [((0,), 3), ((3, 4, 5), 7), (tuple(range(60, 70)), 100), ((0, 1, 2), 40), ((1, 65), 5000)],
)
def test_syndrome_is_the_sum_over_the_edges(planes: tuple[int, ...], num_checks: int) -> None:
    """Each bit is added to the syndrome bits that the graph lists for it."""
    words = random_words(70, 50, seed=num_checks)
    graph = SyndromeGraph(50, planes, num_checks, seed=3)
    expected = np.zeros(num_checks, np.int64)
    for plane, edges in zip(planes, graph.edges(), strict=True):
        for bit, own in zip(plane_of(words, plane), edges, strict=True):
            np.add.at(expected, own[own >= 0], int(bit))
    np.testing.assert_array_equal(syndrome(words, graph), expected % 2)


def test_kernel_is_its_python() -> None:
    """The compiled sums are those of the same loops in Python."""
    words = random_words(6, 30, seed=1)
    graph = SyndromeGraph(30, (0, 2, 5), 11, seed=1)
    sums = np.zeros(11, np.uint8)
    twin = python_twin(_kernels.add_planes)
    twin(words, np.array(graph.planes), bit_orders(30, 1), graph.starts, graph.num_thrice, sums)
    np.testing.assert_array_equal(syndrome(words, graph), sums)
    twin, code = python_twin(_kernels.add_block), block_code(30, 1, 1)
    twin(words, np.array(graph.planes), code, graph.sparsity.numbers, sums[::-1])
    np.testing.assert_array_equal(syndrome(words, graph), sums[::-1])
    twin = python_twin(_kernels.count_thrice)
    assert twin(30, 3, graph.num_checks, graph.sparsity.numbers) == graph.num_thrice < 30


@pytest.mark.parametrize("num_checks", [10, 60, 300])
def test_bits_take_part_in_two_or_three_sums(num_checks: int) -> None:
    """Long syndromes have bits of two sums, short ones none; all sums have about as many bits."""
    graph = SyndromeGraph(120, (0, 1, 2, 3), num_checks, seed=2)
    edges = graph.edges()
    assert (edges[..., :2] >= 0).all()
    twice = float(np.mean(edges[..., 2] < 0))
    rate = num_checks / graph.size
    assert twice == 0.0 if rate <= 0.03 else 0.0 < twice <= 0.5
    loads = np.bincount(edges[edges >= 0], minlength=num_checks)
    assert 0.6 * loads.mean() - 8 < loads.min() <= loads.max() < 1.4 * loads.mean() + 8


@pytest.mark.parametrize("num_checks", [3, 4, 9, 200])
def test_no_bit_is_added_to_a_sum_twice(num_checks: int) -> None:
    """Where two places meet, the later one gives way: twice in a sum is not at all."""
    edges = SyndromeGraph(500, (0, 1, 2, 3, 4), num_checks, seed=1).edges()
    assert all((edges[..., j] != edges[..., k]).all() for j, k in ((0, 1), (0, 2), (1, 2)))


def test_planes_do_not_depend_on_the_others_of_their_block() -> None:
    """A plane has the same places in all blocks of one length and as many planes."""
    one, other = (SyndromeGraph(40, planes, 90, seed=5) for planes in ((0, 1, 7), (3, 7, 9)))
    np.testing.assert_array_equal(one.edges()[2], other.edges()[1])


@pytest.mark.parametrize(("num_bits", "planes", "num_checks"), [(0, (0,), 1), (5, (), 1), (5, (0,), 2)])
def test_empty_blocks_are_refused(num_bits: int, planes: tuple[int, ...], num_checks: int) -> None:
    """There is no code without bits."""
    with pytest.raises(ValueError, match="no syndrome"):
        SyndromeGraph(num_bits, planes, num_checks, seed=1)
