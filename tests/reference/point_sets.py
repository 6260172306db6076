"""Plain twins of the track coder's kernels, written from docs/spec/tracks.md."""

from itertools import product


def free_rows(points: list[tuple[int, int]], column: int, distance: int, num_rows: int) -> list[int]:
    """Return the rows of a column where the next point of a column scan can be."""
    lowest = max((y for x, y in points if x == column), default=0)
    return [
        row
        for row in range(lowest, num_rows)
        if all((column - x) ** 2 + (row - y) ** 2 >= distance**2 for x, y in points)
    ]


def min_distance(points: list[tuple[int, int]], limit: int) -> int:
    """Return the largest whole number, up to a limit, that is no more than any distance."""
    squares = [
        (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2
        for (i, a), (j, b) in product(enumerate(points), repeat=2)
        if i < j
    ]
    return max(n for n in range(limit + 1) if all(n * n <= square for square in squares))
