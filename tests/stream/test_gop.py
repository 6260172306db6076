"""Syntax and bit accounting of a group of pictures."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.config import MAX_GOP_LENGTH, MAX_TICKS_PER_SECOND
from dvc.errors import BitstreamError
from dvc.stream import (
    MAX_DEVIATION_TICKS,
    Deviations,
    GopRecord,
    LongTermReference,
    RecordType,
    decode_gop,
    encode_gop,
    gop_bits,
)
from dvc.stream.records import frame_record

deviations = st.builds(
    lambda clock, ticks, last: Deviations(clock, (*ticks, last)),
    st.integers(1, MAX_TICKS_PER_SECOND),
    st.lists(st.integers(-MAX_DEVIATION_TICKS, MAX_DEVIATION_TICKS), max_size=6),
    st.integers(1, MAX_DEVIATION_TICKS),
)
payloads = st.lists(st.binary(max_size=300), max_size=6)
records = (
    st.builds(
        lambda key, tracks, frames: GopRecord(len(frames) + 1, key, tracks, tuple(frames)),
        st.binary(max_size=300),
        st.binary(max_size=200),
        payloads,
    )
    | st.builds(
        lambda tracks, frames: GopRecord(len(frames), b"", tracks, tuple(frames)),
        st.binary(max_size=200),
        st.lists(st.binary(max_size=300), min_size=1, max_size=6),
    )
    | st.builds(
        lambda tracks, frames, back, matches: GopRecord(
            len(frames), b"", tracks, tuple(frames), long_term=LongTermReference(back, matches)
        ),
        st.binary(min_size=1, max_size=200),
        st.lists(st.binary(max_size=300), min_size=1, max_size=6),
        st.integers(1, 200),
        st.binary(max_size=200),
    )
    | deviations.map(
        lambda given: GopRecord(
            len(given.ticks), b"key", b"tracks", (b"wz",) * (len(given.ticks) - 1), deviations=given
        )
    )
)


@given(records)
def test_decode_gives_back_what_was_encoded(record: GopRecord) -> None:
    """Any group of pictures comes back."""
    assert decode_gop(encode_gop(record)) == record


@given(records)
def test_every_bit_is_accounted_for(record: GopRecord) -> None:
    """Header, key, tracks and Wyner-Ziv bits add up to the record in the file."""
    bits = gop_bits(record)
    assert bits.total == 8 * len(frame_record(RecordType.GOP, encode_gop(record)))
    assert bits.key == 8 * len(record.key)
    matches = record.long_term.matches if record.long_term else b""
    assert bits.tracks == 8 * (len(record.tracks) + len(matches))
    assert bits.wyner_ziv == tuple(8 * len(payload) for payload in record.wyner_ziv)


def test_overhead_is_small() -> None:
    """A record costs eight bytes, a Wyner-Ziv payload one or two, absent tracks nothing."""
    bits = gop_bits(GopRecord(3, bytes(1500), b"", (bytes(127), bytes(128))))
    assert (bits.header, bits.tracks, bits.wyner_ziv_header) == (8 * 8, 0, (8, 16))


def test_a_group_without_key_frame_has_a_payload_for_each_frame() -> None:
    """It is told by the first field, so that other groups cost no more than they did."""
    record = GopRecord(2, b"", b"", (b"one", b"two"))
    assert record.without_key
    assert not GopRecord(2, b"", b"", (b"one",)).without_key
    assert encode_gop(record) == b"\x84\x08\x03one\x03two"
    with pytest.raises(BitstreamError, match="1 bytes are left over in a group without key frame"):
        decode_gop(encode_gop(record) + b"k")


def test_long_term_references_are_for_groups_without_key_frame() -> None:
    """And for those with tracks; the first field tells that there is one."""
    record = GopRecord(2, b"", b"t", (b"one", b"two"), long_term=LongTermReference(3, b"mm"))
    assert encode_gop(record) == b"\x85\x18\x01t\x03\x02mm\x03one\x03two"
    with pytest.raises(ValueError, match="groups that no key frame ends"):
        GopRecord(2, b"k", b"t", (b"one",), long_term=LongTermReference(3, b"mm"))
    with pytest.raises(BitstreamError, match="a long-term reference of a group that a key frame ends"):
        decode_gop(b"\x85\x10\x01t\x03\x02mm\x03onek")
    with pytest.raises(BitstreamError, match="a long-term reference without tracks"):
        decode_gop(b"\x84\x18\x03\x02mm\x03one\x03two")


def test_time_stamps_are_announced_by_the_first_field() -> None:
    """Of groups at the constant frame rate there is nothing."""
    record = GopRecord(2, b"k", b"", (b"one",), deviations=Deviations(1000, (3, -2)))
    assert encode_gop(record) == b"\x84\x20\xe8\x07\x06\x09\x03onek"
    with pytest.raises(ValueError, match="`deviations` must be of 2 frames, got 1"):
        GopRecord(2, b"k", b"", (b"one",), deviations=Deviations(1000, (3,)))


def test_limits_of_a_record() -> None:
    """As many payloads as there are Wyner-Ziv frames, and no more frames than a GOP may have."""
    longest = GopRecord(MAX_GOP_LENGTH, b"k", b"", (b"",) * (MAX_GOP_LENGTH - 1))
    assert decode_gop(encode_gop(longest)) == longest
    for num_frames, num_payloads in ((0, 0), (2, 0), (1, 2), (MAX_GOP_LENGTH + 1, MAX_GOP_LENGTH), (-1, 0)):
        with pytest.raises(ValueError, match=r"`num_frames`|`wyner_ziv`"):
            GopRecord(num_frames, b"", b"", (b"",) * num_payloads)


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        (b"", "data end within an integer"),
        (b"\x00", "0 frames"),
        (b"\x01", "0 frames"),
        (b"\x82\x04", "257 frames"),
        (b"\xff\xff\xff\xff\x7f", "frames"),
        (b"\x03\x00", "announced, but empty"),
        (b"\x03\x05abcd", "5 bytes where at most|5 bytes promised, 4 left"),
        (b"\x04", "data end within an integer"),
        (b"\x04\xff\xff\xff\xff\x7f", "bytes where at most"),
        (b"\x04\x03ab", "3 bytes promised, 2 left"),
        (b"\x82\x20\x00\x02k", "0 ticks a second"),
        (b"\x82\x20\xc1\x84\x3d\x02k", "1000001 ticks a second"),
        (b"\x82\x20\x01", "data end within an integer"),
        (b"\x82\x20\x01\x00k", "are those of the constant frame rate"),
        (b"\x82\x20\x01\x80\x80\x80\x80\x40k", "a time stamp is more than 8589934591 ticks off"),
        (b"\x82\x20\x01\xff\xff\xff\xff\x7fk", "a time stamp is more than 8589934591 ticks off"),
    ],
)
def test_malformed_payloads_are_refused(payload: bytes, message: str) -> None:
    """Numbers that do not fit are named."""
    with pytest.raises(BitstreamError, match=message):
        decode_gop(payload)


@given(st.binary(max_size=40))
def test_arbitrary_payloads_raise_only_bitstream_errors(payload: bytes) -> None:
    """Bytes are refused, or are the one form of a group of pictures."""
    try:
        record = decode_gop(payload)
    except BitstreamError:
        return
    assert encode_gop(record) == payload
