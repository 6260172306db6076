"""Order of decoding, and how far apart references are."""

from hypothesis import given
from hypothesis import strategies as st

from dvc.wynerziv.hierarchy import decoding_order, levels, reference_distances


@given(st.integers(0, 50), st.integers(1, 40), st.booleans())
def test_each_frame_is_decoded_once_after_its_references(
    before: int, length: int, hierarchical: bool
) -> None:
    """All frames between two key frames come, each between references that are known by then."""
    after = before + length
    order = decoding_order(before, after, hierarchical)
    assert sorted(index for index, _ in order) == list(range(before + 1, after))
    known = {before, after}
    for index, (earlier, later) in order:
        assert earlier < index < later
        assert {earlier, later} <= known
        known.add(index)


def test_hierarchical_order_halves_the_distance() -> None:
    """The middle frame comes first, then those between it and the key frames; fifteen frames take 4 steps."""
    assert reference_distances(7, True) == [2, 4, 2, 8, 2, 4, 2]
    assert [len(level) for level in levels(decoding_order(0, 16, True))] == [1, 2, 4, 8]
    assert [len(level) for level in levels(decoding_order(0, 5, False))] == [4]
    assert decoding_order(0, 8, True)[:3] == [(4, (0, 8)), (2, (0, 4)), (6, (4, 8))]
    assert decoding_order(0, 3, False) == [(1, (0, 3)), (2, (0, 3))]


@given(st.integers(0, 40), st.booleans())
def test_distances_are_those_of_the_references(num_frames: int, hierarchical: bool) -> None:
    distances = reference_distances(num_frames, hierarchical)
    assert len(distances) == num_frames
    if not hierarchical:
        assert set(distances) <= {num_frames + 1}
    for index, (first, last) in decoding_order(0, num_frames + 1, hierarchical):
        assert distances[index - 1] == last - first


@given(st.integers(0, 50), st.integers(1, 40), st.booleans())
def test_frames_of_a_level_are_not_predicted_from_each_other(
    before: int, length: int, hierarchical: bool
) -> None:
    order = decoding_order(before, before + length, hierarchical)
    known = {before, before + length}
    for level in levels(order):
        assert all(set(around) <= known for _, around in level)
        known |= {index for index, _ in level}
    assert sorted(place for level in levels(order) for place in level) == sorted(order)
