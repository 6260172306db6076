"""In which order the Wyner-Ziv frames between two key frames are decoded, and from which references."""


def decoding_order(before: int, after: int, hierarchical: bool) -> list[tuple[int, tuple[int, int]]]:
    """Return in which order the frames between two key frames are decoded, and from which references.

    Parameters
    ----------
    before, after : int
        Display positions of the key frames.
    hierarchical : bool
        Whether the middle frame comes first and serves the others as a reference.

    Returns
    -------
    list of (int, (int, int))
        Display position of each frame, and of its two references.
    """
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


def reference_distances(num_frames: int, hierarchical: bool) -> list[int]:
    """Return how far apart the references of the frames between two key frames are.

    Parameters
    ----------
    num_frames : int
        Frames between the key frames.
    hierarchical : bool
        Whether the middle frame comes first and serves the others as a reference.

    Returns
    -------
    list of int
        For each frame, in order of display.
    """
    order = sorted(decoding_order(0, num_frames + 1, hierarchical))
    return [last - first for _, (first, last) in order]
