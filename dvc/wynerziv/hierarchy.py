"""In which order the Wyner-Ziv frames of a group of pictures are decoded, and from which references."""

from collections.abc import Sequence
from itertools import pairwise

from dvc.config import MAX_GOP_LENGTH

Around = tuple[int, int | None]
"""Display positions of the nearest references before a frame and after it; none after a P-type frame."""
WITHOUT_SECOND_REFERENCE = MAX_GOP_LENGTH + 1
"""Stands for how far apart the references of a P-type frame are: farther than any two."""


def decoding_order(before: int, after: int, hierarchical: bool) -> list[tuple[int, tuple[int, int]]]:
    """Return in which order the frames between two key frames are decoded, and from which references."""
    if not hierarchical:
        return [(index, (before, after)) for index in range(before + 1, after)]
    order: list[tuple[int, tuple[int, int]]] = []
    spans = [(before, after)]
    for first, last in spans:
        if last - first >= 2:
            middle = (first + last) // 2
            order.append((middle, (first, last)))
            spans += [(first, middle), (middle, last)]
    return order


def p_type_instants(before: int, last: int, p_type_distance: int) -> list[int]:
    """Return which frames of a group that no key frame ends are P-type frames."""
    count = -(-(last - before) // p_type_distance)
    return [before + (last - before) * number // count for number in range(1, count + 1)]


def p_type_order(
    before: int, last: int, hierarchical: bool, p_type_distance: int
) -> list[tuple[int, Around]]:
    """Return in which order the frames of a group that no key frame ends are decoded."""
    ends = [before, *p_type_instants(before, last, p_type_distance)]
    order: list[tuple[int, Around]] = [(p_type, (previous, None)) for previous, p_type in pairwise(ends)]
    for first, second in pairwise(ends):
        order += decoding_order(first, second, hierarchical)
    return order


def group_order(
    before: int, last: int, hierarchical: bool, p_type_distance: int = 0
) -> list[tuple[int, Around]]:
    """Return in which order the Wyner-Ziv frames of a group are decoded, and from which references."""
    if p_type_distance:
        return p_type_order(before, last, hierarchical, p_type_distance)
    return [*decoding_order(before, last, hierarchical)]


def levels(order: Sequence[tuple[int, Around]]) -> list[list[tuple[int, Around]]]:
    """Put frames together that are not predicted from each other."""
    found: list[list[tuple[int, Around]]] = [[place] for place in order if place[1][1] is None]
    num_p_types, level_of = len(found), dict[int, int]()
    for index, (before, after) in order:
        if after is not None:
            level = max(level_of.get(before, -1), level_of.get(after, -1)) + 1
            level_of[index] = level
            if num_p_types + level == len(found):
                found.append([])
            found[num_p_types + level].append((index, (before, after)))
    return found


def reference_distance(around: Around) -> int:
    """Return how far apart the references of a frame are; P-type frames have one."""
    before, after = around
    return WITHOUT_SECOND_REFERENCE if after is None else after - before


def reference_distances(num_frames: int, hierarchical: bool, p_type_distance: int = 0) -> list[int]:
    """Return how far apart the references of the Wyner-Ziv frames of a group are."""
    last = num_frames if p_type_distance else num_frames + 1
    order = sorted(group_order(0, last, hierarchical, p_type_distance))
    return [reference_distance(around) for _, around in order]
