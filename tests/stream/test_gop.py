"""Syntax and bit accounting of a group of pictures."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvc.config import MAX_GOP_LENGTH
from dvc.errors import BitstreamError
from dvc.limits import MAX_TICKS_PER_SECOND
from dvc.stream import (
    MAX_DEVIATION_TICKS,
    Deviations,
    GopRecord,
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
records = st.builds(
    lambda key, predicted, tracks, frames: GopRecord(len(frames) + 1, key, predicted, tracks, tuple(frames)),
    st.binary(max_size=300),
    st.booleans(),
    st.binary(max_size=200),
    payloads,
) | deviations.map(
    lambda given: GopRecord(
        len(given.ticks), b"key", True, b"tracks", (b"wz",) * (len(given.ticks) - 1), deviations=given
    )
)


@given(records)
def test_groups_come_back_and_every_bit_is_accounted_for(record: GopRecord) -> None:
    assert decode_gop(encode_gop(record)) == record
    bits = gop_bits(record)
    assert bits.total == 8 * len(frame_record(RecordType.GOP, encode_gop(record)))
    assert bits.key == 8 * len(record.key)
    assert bits.tracks == 8 * len(record.tracks)
    assert bits.wyner_ziv == tuple(8 * len(payload) for payload in record.wyner_ziv)


def test_overhead_is_small() -> None:
    """A record costs eight bytes, a Wyner-Ziv payload one or two, absent tracks nothing."""
    bits = gop_bits(GopRecord(3, bytes(1500), True, b"", (bytes(127), bytes(128))))
    assert (bits.header, bits.tracks, bits.wyner_ziv_header) == (8 * 8, 0, (8, 16))


@pytest.mark.parametrize(
    ("record", "payload"),
    [
        (GopRecord(1, b"k"), b"\x04k"),
        (GopRecord(1, b"k", True), b"\x06k"),
        (GopRecord(1, b""), b"\x04"),
        (GopRecord(3, b"k", False, b"", (b"one", b"")), b"\x0c\x03one\x00k"),
        (GopRecord(2, b"k", True, b"tr", (b"one",)), b"\x0b\x02tr\x03onek"),
        (
            GopRecord(2, b"k", wyner_ziv=(b"one",), deviations=Deviations(1000, (3, -2))),
            b"\x88\x10\xe8\x07\x06\x09\x03onek",
        ),
    ],
    ids=["IDR", "predicted", "empty", "Wyner-Ziv", "tracks", "time stamps"],
)
def test_the_first_field_tells_what_follows(record: GopRecord, payload: bytes) -> None:
    """4 times the number of frames, 2 if the key frame is predicted, 1 for tracks, 2048 for time stamps."""
    assert encode_gop(record) == payload
    assert decode_gop(payload) == record


def test_limits_of_a_record() -> None:
    longest = GopRecord(MAX_GOP_LENGTH, b"k", True, b"", (b"",) * (MAX_GOP_LENGTH - 1))
    assert decode_gop(encode_gop(longest)) == longest
    for num_frames, num_payloads in ((0, 0), (2, 0), (2, 2), (MAX_GOP_LENGTH + 1, MAX_GOP_LENGTH), (-1, 0)):
        with pytest.raises(ValueError, match=r"`num_frames`|`wyner_ziv`"):
            GopRecord(num_frames, b"", False, b"", (b"",) * num_payloads)
    with pytest.raises(ValueError, match="`deviations` must be of 2 frames, got 1"):
        GopRecord(2, b"k", wyner_ziv=(b"one",), deviations=Deviations(1000, (3,)))


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        (b"", "data end within an integer"),
        (b"\x00", "0 frames"),
        (b"\x80\x10", "0 frames"),
        (b"\x84\x08", "257 frames"),
        (b"\xff\xff\xff\xff\x7f", "frames"),
        (b"\x05\x00", "announced, but empty"),
        (b"\x05\x05abcd", "5 bytes, at most|5 bytes promised, 4 left"),
        (b"\x08\xff\xff\xff\xff\x7f", "bytes promised, 0 left"),
        (b"\x08\x03ab", "3 bytes promised, 2 left"),
        (b"\x84\x10\x00\x02k", "0 ticks a second"),
        (b"\x84\x10\xc1\x84\x3d\x02k", "1000001 ticks a second"),
        (b"\x84\x10\x01\x00k", "equal those of the constant frame rate"),
        (b"\x84\x10\x01\x80\x80\x80\x80\x40k", "a time stamp is more than 8589934591 ticks off"),
        (b"\x84\x10\x01\xff\xff\xff\xff\x7fk", "a time stamp is more than 8589934591 ticks off"),
    ],
)
def test_malformed_payloads_are_refused(payload: bytes, message: str) -> None:
    with pytest.raises(BitstreamError, match=message):
        decode_gop(payload)


@given(st.binary(max_size=40))
def test_arbitrary_payloads_raise_only_bitstream_errors(payload: bytes) -> None:
    try:
        record = decode_gop(payload)
    except BitstreamError:
        return
    assert encode_gop(record) == payload
