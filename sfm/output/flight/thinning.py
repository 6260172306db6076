"""As many items of a series as there is room for, evenly spaced."""

from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Thinned(Generic[Item]):
    """Keeps every item of a series, then every second one, and so on, so that they stay within a size."""

    def __init__(self, max_size: int, max_items: int, size_of: Callable[[Item], int]) -> None:
        self._max_size, self._max_items, self._size_of = max_size, max_items, size_of
        self._stride, self._count = 1, 0
        self.items: list[Item] = []

    def offer(self, make: Callable[[], Item]) -> None:
        """Make the next item of the series and keep it, unless it is left out as others are."""
        if self._count % self._stride == 0:
            self.items.append(make())
            while len(self.items) > 1 and self._is_too_much():
                self.items = self.items[::2]
                self._stride *= 2
        self._count += 1

    def _is_too_much(self) -> bool:
        size = sum(self._size_of(item) for item in self.items)
        return len(self.items) > self._max_items or size > self._max_size
