"""In which order the Wyner-Ziv frames of a group of pictures are decoded, and from which references."""

from collections.abc import Sequence
from itertools import pairwise

from dvc.config import MAX_GOP_LENGTH

Around = tuple[int, int | None]
"""Display positions of the nearest reference before a frame, and of that after it; none after an anchor."""


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


def anchor_instants(before: int, last: int, anchor_distance: int) -> list[int]:
    """Return which frames of a group that no key frame ends are anchors."""
    count = -(-(last - before) // anchor_distance)
    return [before + (last - before) * number // count for number in range(1, count + 1)]


def anchored_order(
    before: int, last: int, hierarchical: bool, anchor_distance: int
) -> list[tuple[int, Around]]:
    """Return in which order the frames of a group that no key frame ends are decoded."""
    ends = [before, *anchor_instants(before, last, anchor_distance)]
    order: list[tuple[int, Around]] = [(anchor, (previous, None)) for previous, anchor in pairwise(ends)]
    for first, second in pairwise(ends):
        order += decoding_order(first, second, hierarchical)
    return order


def group_order(
    before: int, last: int, hierarchical: bool, anchor_distance: int = 0
) -> list[tuple[int, Around]]:
    """Return in which order the Wyner-Ziv frames of a group are decoded, and from which references."""
    if anchor_distance:
        return anchored_order(before, last, hierarchical, anchor_distance)
    return [*decoding_order(before, last, hierarchical)]


def levels(order: Sequence[tuple[int, Around]]) -> list[list[tuple[int, Around]]]:
    """Put frames together that are not predicted from each other."""
    found: list[list[tuple[int, Around]]] = [[place] for place in order if place[1][1] is None]
    num_anchors, level_of = len(found), dict[int, int]()
    for index, (before, after) in order:
        if after is not None:
            level = max(level_of.get(before, -1), level_of.get(after, -1)) + 1
            level_of[index] = level
            if num_anchors + level == len(found):
                found.append([])
            found[num_anchors + level].append((index, (before, after)))
    return found


def reference_distance(around: Around) -> int:
    """Return how far apart the references of a frame are."""
    before, after = around
    return MAX_GOP_LENGTH if after is None else after - before


def reference_distances(num_frames: int, hierarchical: bool, anchor_distance: int = 0) -> list[int]:
    """Return how far apart the references of the Wyner-Ziv frames of a group are."""
    last = num_frames if anchor_distance else num_frames + 1
    order = sorted(group_order(0, last, hierarchical, anchor_distance))
    return [reference_distance(around) for _, around in order]
