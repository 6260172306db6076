"""Whether dynamic programming finds the trees of exhaustive search."""

from benchmarks.figures.harness import Figure, Measured, Setting
from dvc.dibr.disparity.dynamic_programming import optimise_tree
from dvc.dibr.disparity.integer_transforms import L_TRANSFORM, S_TRANSFORM
from tests.reference.dibr_trees import ExhaustiveSearch, cost_of, general_cases, laplacian_cases

AREA = "dibr"
NUM_CASES = 1000


def exhaustive(setting: Setting, clip: str) -> Measured:
    """Compare least costs on random small trees in L and S, half of them with costs of (3.19) alone."""
    del clip
    count = setting.choose(NUM_CASES, 40) // 4
    same = {transform.name: 0 for transform in (L_TRANSFORM, S_TRANSFORM)}
    for transform in (L_TRANSFORM, S_TRANSFORM):
        search = ExhaustiveSearch()
        for cases in (general_cases, laplacian_cases):
            for tensor, costs, previous in cases(transform, count):
                tree, total = optimise_tree(transform, tensor, costs, previous)
                least = float(search.costs(transform, tensor, costs, previous).min())
                same[transform.name] += total == least == cost_of(tree, tensor, costs, previous)
    found, total_count = sum(same.values()), 4 * count
    each = ", ".join(f"{name.upper()} {number} of {2 * count}" for name, number in same.items())
    values = {f"{name}_same": number for name, number in same.items()} | {"num_cases": total_count}
    return Measured(f"{found} of {total_count} ({each})", found == total_count, values)


FIGURES = (
    Figure(
        AREA,
        "exhaustive",
        "dynamic programming against exhaustive search, random small trees: exactly the same least cost",
        f"all of {NUM_CASES:,}",
        exhaustive,
    ),
)
"""The figures of this module."""
