"""A reader of point tracks, written from docs/spec/tracks.md; it imports no package."""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import exp, floor, log, sqrt

from tests.reference.stream_reader import RangeReader

Point = tuple[int, int]
Track = list[Point | None]

MIDDLES = [(i + 0.5) / 4096 for i in range(4096)]
STRETCH = [round(2**12 * log(m / (1 - m))) / 2**12 for m in MIDDLES]
SQUASH = [min(max(round(2**20 / (1 + exp(12 - 24 * m))) / 2**20, 2**-13), 1 - 2**-13) for m in MIDDLES]
RANGE = range(10)


def within(x: float, low: float, high: float) -> float:
    """Limit a number."""
    return min(max(x, low), high)


def squash(z: float) -> float:
    """Return what the table has for a logarithm of odds."""
    return SQUASH[floor((z + 12.0) * (4096 / 24))]


def logistic(z: float) -> float:
    """Return the logistic function."""
    return squash(within(z, 0.01 - 12.0, 12.0 - 0.01))


class Curves:
    """What probabilities have turned out to mean."""

    def __init__(self, coder: RangeReader) -> None:
        self._coder = coder
        self._curves = [[squash(0.73 * n - 8.4) for n in range(25)] for _ in range(5)]

    def refined(self, number: int, p: float) -> int:
        """Read a decision."""
        p, curve = within(p, 1 / 4096, 1 - 1 / 4096), self._curves[number]
        u = (STRETCH[floor(4096 * p)] + 8.4) / 0.73
        n = floor(u)
        f = u - n
        d = self._coder.decision(within((1 - f) * curve[n] + f * curve[n + 1], 1 / 4096, 1 - 1 / 4096))
        curve[n] += (0.02 * (1 - f)) * (d - curve[n])
        curve[n + 1] += (0.02 * f) * (d - curve[n + 1])
        return d

    def coordinate(self, q: float, b: float) -> int:
        """Read where something is, that is predicted at q."""
        n = floor(q + 0.5)
        o = q - n
        below, above = logistic((-0.5 - o) / b), 1.0 - logistic((0.5 - o) / b)
        if not self.refined(0, above + below):
            return n
        up = self.refined(1, above / (above + below))
        o = o if up else -o
        m = 0
        while True:
            m += 1
            here, beyond = logistic((o + 0.5 - m) / b), logistic((o - 0.5 - m) / b)
            if not self.refined(2 + min(m - 1, 2), within(beyond / here, 1e-3, 0.98)):
                break
            if m == 15:
                m = 16 + self._rest()
                break
        return n + m if up else n - m

    def _rest(self) -> int:
        exponent, number = 0, 1
        while self._coder.decision(0.5):
            exponent += 1
        for _ in range(exponent):
            number = 2 * number + self._coder.decision(0.5)
        return number - 1


@dataclass
class State:
    """A track while it is read."""

    first: Point
    place: list[float]
    velocity: list[float] = field(default_factory=lambda: [0.0, 0.0])
    magnitude: float = 0.6
    neighbours: list[tuple[int, float]] = field(default_factory=list)
    phi: list[float] = field(default_factory=list)
    start: list[float] = field(default_factory=list)
    expected: list[float] = field(default_factory=list)
    size: float = 0.0


class Direction:
    """Tracks in one direction of time."""

    def __init__(
        self, coder: RangeReader, curves: Curves, sides: Point, bits: int, losses: list[list[float]]
    ) -> None:
        self._coder, self._curves, self._sides, self._pixel = coder, curves, sides, float(2**bits)
        self._losses = losses
        self._level, self._weight, self._squares = 0.6, 0.0, [0.0] * 10

    def read(self, given: list[Track], firsts: list[Point], num_instants: int) -> list[Track]:
        """Read where tracks go from their first positions; return them in this order."""
        digits = max((len(firsts) - 1).bit_length(), 1)
        order = sorted(range(len(firsts)), key=lambda k: int(f"{k:0{digits}b}"[::-1], 2))
        tracks = [*given, *([firsts[k]] for k in order)]
        self._states = [State(track[0], [*map(float, track[0])]) for track in tracks]  # type: ignore[arg-type]
        self._find_neighbours()
        for t in range(1, num_instants):
            self._read_instant(tracks, len(given), t)
        found = dict(zip(order, tracks[len(given) :], strict=True))
        return [found[k] for k in range(len(firsts))]

    def _find_neighbours(self) -> None:
        reach = max(self._sides[0] * self._sides[1] / 69, 1.0)
        for i, state in enumerate(self._states):
            weights = []
            for j in range(i):
                square = float(
                    sum((a - b) ** 2 for a, b in zip(state.first, self._states[j].first, strict=True))
                )
                ratio = reach / (reach + square)
                weights.append((j, ratio * ratio))
            state.neighbours = sorted(weights, key=lambda one: (-one[1], one[0]))[:8]

    def _variances(self, tracks: list[Track], t: int) -> list[float]:
        known = [state for state, track in zip(self._states, tracks, strict=True) if track[t - 1] is not None]
        speed = 0.0
        for state in known:
            speed += abs(state.velocity[0]) + abs(state.velocity[1])
        c = 5.0 if t == 1 else 0.53 + 0.73 * speed / max(2 * len(known), 1)
        if t == 1:
            deviations = [c, 0.5 * c, 0.5 * c, 0.0, 0.0, 0.0, 0.0, 0.55 * c, 0.55 * c, 0.55 * c]
        else:
            deviations = [c, 0.36 * c, 0.36 * c, 1.4, 1.4, 0.5, 0.5, 0.14 * c, 0.14 * c, 0.14 * c]
        found = [each * each for each in deviations]
        if t > 2 and self._weight > 0.0:
            u = self._weight / (self._weight + 0.22)
            pairs = zip(self._squares, found, strict=True)
            found = [u * (square / self._weight) + (1.0 - u) * own for square, own in pairs]
        return found

    def _fit(self, state: State, axis: int) -> float:
        fit = state.start[axis]
        for k in RANGE:
            fit += state.phi[k] * self._beta[k][axis]
        return fit

    def _features(self, state: State, t: int) -> list[float]:
        (width, height), (x, y) = self._sides, state.place
        z = 2.8 / max(width, height)
        across, down = (x - 0.5 * width) * z, (y - 0.5 * height) * z
        motion = [0.0] * 4
        if t > 1:
            motion = [(x - state.first[0]) / t, (y - state.first[1]) / t, *state.velocity]
        return [1.0, across, down, *motion, across * across, across * down, down * down]

    def _gains(self, phi: list[float]) -> tuple[list[float], float]:
        gains = []
        for m in RANGE:
            total = 0.0
            for k in RANGE:
                total += self._P[k][m] * phi[k]
            gains.append(total)
        u = 0.0
        for k in RANGE:
            u += phi[k] * gains[k]
        u = max(u, 0.0)
        for k in RANGE:
            if gains[k] * gains[k] > self._P[k][k] * u:
                gains[k] = sqrt(self._P[k][k] * u) * (1.0 if gains[k] > 0.0 else -1.0)
        return gains, u

    def _read_instant(self, tracks: list[Track], num_given: int, t: int) -> None:
        self._beta = [[0.0, 0.0] for _ in RANGE]
        variances = self._variances(tracks, t)
        self._P = [[variances[k] if k == m else 0.0 for m in RANGE] for k in RANGE]
        known: list[int] = []
        for i, track in enumerate(tracks):
            if track[t - 1] is None:
                if i >= num_given:
                    track.append(None)
            elif self._read_position(i, tracks, known, i < num_given, t):
                known.append(i)
        self._finish(tracks, known, t)

    def _read_position(self, i: int, tracks: list[Track], known: list[int], is_given: bool, t: int) -> bool:
        state, track = self._states[i], tracks[i]
        state.phi = self._features(state, t)
        state.start = [state.place[axis] + 0.14 * state.velocity[axis] for axis in (0, 1)]
        gains, u = self._gains(state.phi)
        error, around, total = [0.0, 0.0], 0.0, 0.0
        for j, weight in state.neighbours:
            if j in known:
                for axis in (0, 1):
                    error[axis] += weight * (tracks[j][t][axis] - self._fit(self._states[j], axis))  # type: ignore[index]
                around += weight * self._states[j].size
                total += weight
        fit = [self._fit(state, axis) for axis in (0, 1)]
        p = [within(fit[axis] + error[axis] / (total + 1.0), 0.0, self._sides[axis] - 1.0) for axis in (0, 1)]
        if t == 1:
            r = (around + 0.6 * self._level) / (total + 0.3)
        else:
            r = (around + 3.3 * state.magnitude + 0.3 * self._level) / (total + 3.6)
        scale = sqrt(r * r + 1.3 * u)
        if not is_given:
            if self._is_lost(p, scale):
                track.append(None)
                return False
            b = 0.51 * max(scale, 0.1)
            track.append((self._curves.coordinate(p[0], b), self._curves.coordinate(p[1], b)))
        where = track[t]
        assert where is not None
        assert all(0 <= where[axis] < self._sides[axis] for axis in (0, 1))
        state.expected = p
        state.size = 0.5 * (abs(where[0] - p[0]) + abs(where[1] - p[1])) * r / max(scale, 1e-9)
        state.magnitude += 0.35 * (min(state.size, 8.0) - state.magnitude)
        noise = (0.47 if t == 1 else 0.12) + 0.5 * r * r
        self._learn(gains, u, noise, [where[axis] - fit[axis] for axis in (0, 1)])
        return True

    def _is_lost(self, p: list[float], scale: float) -> bool:
        width, height = self._sides
        edge = min(p[0], width - 1 - p[0], p[1], height - 1 - p[1])
        near = edge < 6.0 * self._pixel + 2.0 * scale
        context = self._losses[0 if near else 1 if edge < 20.0 * self._pixel else 2]
        lost = self._coder.decision(context[0] / context[1])
        context[0] += lost
        context[1] += 1.0
        return bool(lost)

    def _learn(self, gains: list[float], u: float, noise: float, error: list[float]) -> None:
        y, h = max(error[0] * error[0], error[1] * error[1]), 8.0 * (noise + u)
        if y > h:
            noise *= y / h
        h = 1.0 / (max(noise, 2.0**-40 * u) + u)
        for k in RANGE:
            for axis in (0, 1):
                self._beta[k][axis] = within(self._beta[k][axis] + gains[k] * h * error[axis], -1e4, 1e4)
        for m in RANGE:
            for k in RANGE:
                self._P[k][m] -= gains[k] * gains[m] * h

    def _finish(self, tracks: list[Track], known: list[int], t: int) -> None:
        if known:
            total = 0.0
            for i in known:
                total += self._states[i].size
            self._level = 0.5 * self._level + 0.5 * total / len(known)
        if t > 1 and len(known) >= 8:
            self._weight = 0.8 * self._weight + 1.0
            for k in RANGE:
                x, y = self._beta[k]
                square = 0.5 * (x * x + y * y) + max(self._P[k][k], 0.0)
                self._squares[k] = 0.8 * self._squares[k] + square
        for i in known:
            state, where = self._states[i], tracks[i][t]
            for axis, side in enumerate(self._sides):
                b = 0.5 * (self._fit(state, axis) + state.expected[axis])
                e = where[axis] - b  # type: ignore[index]
                velocity = b - state.place[axis] + (1.0 if t == 1 else 0.33) * e
                state.velocity[axis] = within(velocity, -side, side)
                state.place[axis] = within(b + 0.75 * e, -side, 2.0 * side)


def read_first(
    coder: RangeReader, count: int, taken: list[Point], sides: Point, point_set: Callable[..., list[Point]]
) -> list[Point]:
    """Read the first positions of tracks; in a grid that is too fine, or of no distance, a point set."""
    exponent, apart = coder.number(8), coder.number(256)
    columns, rows = ((side - 1 >> exponent) + 1 for side in sides)
    if apart == 0 or columns * rows > 2**18:
        return [(x << exponent, y << exponent) for x, y in point_set(coder, count, columns, rows, apart)]
    guard = coder.number(256)
    free = {
        (x, y)
        for x in range(columns)
        for y in range(rows)
        if all(
            ((x << exponent) - px) ** 2 + ((y << exponent) - py) ** 2 >= (guard << exponent) ** 2
            for px, py in taken
        )
    }
    told = [[2.0, 4.0], [3.6, 4.0], [4.4, 4.0], [5.2, 4.0]]
    found: list[Point] = []
    for cell in sorted(free):
        left = count - len(found)
        if left == 0:
            break
        if cell not in free:
            continue
        squares = [(cell[0] - x) ** 2 + (cell[1] - y) ** 2 for x, y in found]
        near = told[min(sum(square <= ((5 * apart + 1) // 2) ** 2 for square in squares), 3)]
        expected = left / max(float(len(free) - (left - 1) * apart * apart), float(left))
        here = 1
        if left < len(free):
            here = coder.decision(within(expected * (near[0] / near[1]), 1e-4, 0.97))
        near[1] += expected
        free.discard(cell)
        if here:
            near[0] += 1.0
            found.append(cell)
            free = {one for one in free if (one[0] - cell[0]) ** 2 + (one[1] - cell[1]) ** 2 >= apart**2}
    assert len(found) == count
    return [(x << exponent, y << exponent) for x, y in found]
