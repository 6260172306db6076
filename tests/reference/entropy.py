"""Plain twins of the entropy coder: an interval in numbers of any size, and decisions as lists."""

from fractions import Fraction

Part = tuple[int, int]  # where some of 2^24 equal parts of the interval begin, and how many they are
Decision = tuple[int, int]  # a context, and what is decided in it; -1 where both are as probable


def of_decision(probability: float, decision: int) -> Part:
    """Return the parts that stand for a decision; zeros come first."""
    zeros = int((1.0 - probability) * (2**24 - 2)) + 1
    return (zeros, 2**24 - zeros) if decision else (0, zeros)


def of_number(bound: int, value: int) -> Part:
    """Return the parts that stand for a number; the last one has what is left over."""
    width = 2**24 // bound
    return value * width, width if value < bound - 1 else 2**24 - value * width


def as_bytes(parts: list[Part]) -> bytes:
    """Narrow the interval, with a number that grows by 32 bits whenever it has become narrow."""
    low, width, words = 0, 2**64 - 1, 0
    for start, count in parts:
        low, width = low + (width >> 24) * start, (width >> 24) * count
        if width < 2**32:
            low, width, words = low << 32, width << 32, words + 1
    number = (low + 2**32 - 1) >> 32 if parts else 0
    return number.to_bytes(4 * words + 4).rstrip(b"\0") or b"\0"


class Context:
    """A context that counts in steps of 16, as documented."""

    def __init__(self, percent: int) -> None:
        self.ones = 320 * percent // 100
        self.zeros = 320 - self.ones

    def probability(self) -> Fraction:
        """Return that of a 1."""
        return Fraction(self.ones, self.zeros + self.ones)

    def see(self, decision: int) -> None:
        """Count a decision."""
        self.ones, self.zeros = self.ones + 16 * decision, self.zeros + 16 * (1 - decision)
        if self.zeros + self.ones > 1024:
            self.ones, self.zeros = (self.ones + 1) // 2, (self.zeros + 1) // 2


def exp_golomb(value: int, zero: int, sign: int, exponents: int, mantissas: int) -> list[Decision]:
    """Return the decisions of a number with their contexts: its digits, after how many they are."""
    if value == 0:
        return [(zero, 0)]
    digits = [int(digit) for digit in f"{abs(value) + 1:b}"[1:]]
    unary = [1] * (len(digits) - 1) + [0]
    return [
        (zero, 1),
        (sign, int(value > 0)),
        *((exponents + min(k, 11), more) for k, more in enumerate(unary, 1)),
        (mantissas + min(len(digits), 11), digits[0]),
        *((-1, digit) for digit in digits[1:]),
    ]
