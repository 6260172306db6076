"""Order of decoding of the Wyner-Ziv frames of a group of pictures, and their references."""

from collections.abc import Sequence

Around = tuple[int, int]
"""Display positions of the nearest references before a frame and after it."""


def decoding_order(before: int, after: int, hierarchical: bool) -> list[tuple[int, Around]]:
    """Return the frames between two key frames in order of decoding, with their references."""
    if not hierarchical:
        return [(index, (before, after)) for index in range(before + 1, after)]
    order: list[tuple[int, Around]] = []
    spans = [(before, after)]
    for first, last in spans:
        if last - first >= 2:
            middle = (first + last) // 2
            order.append((middle, (first, last)))
            spans += [(first, middle), (middle, last)]
    return order


def levels(order: Sequence[tuple[int, Around]]) -> list[list[tuple[int, Around]]]:
    """Put frames together that are not predicted from each other."""
    found: list[list[tuple[int, Around]]] = []
    level_of: dict[int, int] = {}
    for index, (before, after) in order:
        level = level_of[index] = max(level_of.get(before, -1), level_of.get(after, -1)) + 1
        if level == len(found):
            found.append([])
        found[level].append((index, (before, after)))
    return found


def reference_distances(num_frames: int, hierarchical: bool) -> list[int]:
    """Return how far apart the references of the Wyner-Ziv frames of a group are."""
    order = sorted(decoding_order(0, num_frames + 1, hierarchical))
    return [after - before for _, (before, after) in order]
