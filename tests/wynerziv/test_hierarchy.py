"""Order of decoding, and how far apart references are."""

from hypothesis import given
from hypothesis import strategies as st

from dvc.wynerziv.hierarchy import decoding_order, group_order, levels, p_type_order, reference_distances


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
    """The middle frame comes first, then those between it and the key frames."""
    assert decoding_order(0, 8, True)[:3] == [(4, (0, 8)), (2, (0, 4)), (6, (4, 8))]
    assert decoding_order(0, 3, False) == [(1, (0, 3)), (2, (0, 3))]


@given(st.integers(0, 40), st.booleans())
def test_distances_are_those_of_the_references(num_frames: int, hierarchical: bool) -> None:
    """In order of display; between key frames all references are equally far apart."""
    distances = reference_distances(num_frames, hierarchical)
    assert len(distances) == num_frames
    if not hierarchical:
        assert set(distances) <= {num_frames + 1}
    for index, (first, last) in decoding_order(0, num_frames + 1, hierarchical):
        assert distances[index - 1] == last - first


def test_distances_of_a_group_of_eight() -> None:
    """The middle frame lies between the key frames, every second one between its neighbours."""
    assert reference_distances(7, True) == [2, 4, 2, 8, 2, 4, 2]


@given(st.integers(0, 50), st.integers(1, 40), st.booleans(), st.integers(1, 40))
def test_p_type_frames_come_first_and_know_only_what_is_before_them(
    before: int, length: int, hierarchical: bool, distance: int
) -> None:
    """The last frame is a P-type frame, none is farther than allowed, and all other frames follow."""
    last = before + length
    order = p_type_order(before, last, hierarchical, distance)
    assert sorted(index for index, _ in order) == list(range(before + 1, last + 1))
    p_types = [(index, around[0]) for index, around in order if around[1] is None]
    assert [index for index, _ in order][: len(p_types)] == [index for index, _ in p_types]
    assert p_types[-1][0] == last
    assert all(0 < index - previous <= distance for index, previous in p_types)
    known = {before, *(index for index, _ in p_types)}
    for index, (earlier, later) in order[len(p_types) :]:
        assert later is not None
        assert earlier < index < later
        assert {earlier, later} <= known
        known.add(index)


def test_distances_of_a_group_with_p_type_frames() -> None:
    """P-type frames count as if their references were farther apart than any may be."""
    far = 257
    assert reference_distances(8, True, 4) == [2, 4, 2, far, 2, 4, 2, far]
    assert reference_distances(3, True, 8) == [3, 2, far]


@given(st.integers(0, 50), st.integers(1, 40), st.booleans(), st.integers(0, 9))
def test_frames_of_a_level_are_not_predicted_from_each_other(
    before: int, length: int, hierarchical: bool, p_type_distance: int
) -> None:
    """Each frame is in one level: its references, and P-type frames before others, are in earlier ones."""
    order = group_order(before, before + length, hierarchical, p_type_distance)
    p_types = {index for index, (_, after) in order if after is None}
    known = {before} if p_type_distance else {before, before + length}
    for level in levels(order):
        for _, around in level:
            assert {place for place in around if place is not None} <= known
            assert around[1] is None or p_types <= known
        assert len(level) == 1 or all(around[1] is not None for _, around in level)
        known |= {index for index, _ in level}
    assert sorted(place for level in levels(order) for place in level) == sorted(order)


def test_levels_are_few() -> None:
    """Sixteen frames take four steps, or five where the last of them are P-type frames."""
    assert [len(level) for level in levels(group_order(0, 16, True))] == [1, 2, 4, 8]
    assert [len(level) for level in levels(group_order(0, 16, True, 8))] == [1, 1, 2, 4, 8]
    assert [len(level) for level in levels(group_order(0, 5, False))] == [4]
