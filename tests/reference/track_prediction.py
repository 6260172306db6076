"""Plain twins of the track coder's kernels, written from docs/tracks.md."""

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


def weight(a: tuple[int, int], b: tuple[int, int], reach: int) -> int:
    """Return the weight of one point for another."""
    ratio = (reach << 12) // (reach + (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2)
    return ratio * ratio // 256


class AxisFilter:
    """One coordinate of one track: filtered position, velocity and last residual in 1/256 units."""

    def __init__(self, position: int) -> None:
        self.position, self.velocity, self.residual = 256 * position, 0, 0
        self.prediction = self.correction = 0

    def predict(self, before: list[tuple["AxisFilter", int, int]], side: int) -> int:
        """Predict from tracks that are known at this instant: filter, position, weight of each."""
        total = sum(weight for _, _, weight in before)
        surplus = sum(
            weight * (256 * position - other.position - other.velocity) for other, position, weight in before
        )
        self.correction = surplus // (total + 3932)
        expected = self.position + self.velocity + self.correction
        self.prediction = min(max(expected, 0), 256 * (side - 1))
        return self.prediction

    def expected_magnitude(self, before: list[tuple["AxisFilter", int, int]], first_step: bool) -> int:
        """Return the magnitude of the residual to expect; the residuals of `before` are of this instant."""
        total = sum(weight for _, _, weight in before)
        magnitude = sum(weight * abs(other.residual) for other, _, weight in before)
        if not first_step:
            return (magnitude + 40960 * abs(self.residual)) // (total + 40960)
        return magnitude // total if total else 1024

    def advance(self, first_step: bool, side: int) -> None:
        """Go on to the next instant, once all residuals of this one are known."""
        self.position = self.prediction + 13 * self.residual // 16
        velocity = self.velocity + self.correction + (self.residual if first_step else self.residual // 2)
        self.velocity = min(max(velocity, -256 * side), 256 * side)
