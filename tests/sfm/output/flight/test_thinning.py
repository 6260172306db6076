"""Series that are thinned evenly."""

from sfm.output.flight_page import Thinned


def test_all_items_are_kept_while_there_is_room() -> None:
    """Nothing is left out below both limits."""
    kept = Thinned[int](100, 10, lambda item: 1)
    for number in range(10):
        kept.offer(lambda number=number: number)  # type: ignore[misc]
    assert kept.items == list(range(10))


def test_what_is_left_is_evenly_spaced_and_within_the_limits() -> None:
    """Items that will not be kept are not made; the first one stays in any case."""
    made = []

    def make(number: int) -> int:
        made.append(number)
        return number

    kept = Thinned[int](70, 100, lambda item: 10)
    for number in range(40):
        kept.offer(lambda number=number: make(number))  # type: ignore[misc]
    assert kept.items == list(range(0, 40, 8))
    assert len(made) < 20
    few = Thinned[int](1, 3, lambda item: 10)
    for number in range(9):
        few.offer(lambda number=number: number)  # type: ignore[misc]
    assert few.items == [0]
