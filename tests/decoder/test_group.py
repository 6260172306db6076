"""Order of decoding, and groups of pictures decoded in memory."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from decoder.group import GroupDecoder, decoding_order
from dvc.config import CodecConfig, SideInformationConfig, VideoConfig
from dvc.errors import BitstreamError


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


def test_unknown_methods_are_refused() -> None:
    """A stream that names a method of the future is refused by name."""
    config = CodecConfig(
        codec="2d", video=VideoConfig(16, 16, 25, 1), side_information=SideInformationConfig(method="magic")
    )
    with pytest.raises(BitstreamError, match="'magic'; there are mci"):
        GroupDecoder(config)
