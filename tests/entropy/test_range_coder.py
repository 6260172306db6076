"""Range coder: exact inverse, the bytes of the plain twin and of constriction, damage."""

from contextlib import nullcontext

import numpy as np
import pytest
from constriction import stream
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.entropy import RangeCoder, code_decision, code_uniform
from dvc.entropy.range_coder import POSITION, has_room, is_settled
from dvc.errors import BitstreamError
from tests.reference import entropy as reference

Symbol = tuple[float, int, int]  # probability and decision; or 0, a bound and a number

PROBABILITIES = st.one_of(
    st.floats(1e-12, 1.0, exclude_max=True), st.sampled_from([0.5, 1e-9, 1 - 1e-9, 1 / 3])
)
BOUNDS = st.one_of(st.integers(1, 300), st.sampled_from([2**24, 2**24 - 1, 65537]))
DECISIONS = st.tuples(PROBABILITIES, st.just(0), st.integers(0, 1))
NUMBERS = BOUNDS.flatmap(
    lambda bound: st.tuples(
        st.just(0.0), st.just(bound), st.one_of(st.integers(0, bound - 1), st.just(bound - 1))
    )
)
SYMBOLS = st.lists(st.one_of(DECISIONS, NUMBERS), max_size=60)


def coded(coder: RangeCoder, symbols: list[Symbol]) -> list[Symbol]:
    """Write symbols, or read those of the same models."""
    state = coder.room_for(len(symbols))
    values = [
        code_uniform(state, bound, value) if bound else code_decision(state, probability, value)
        for probability, bound, value in symbols
    ]
    return [
        (probability, bound, value) for (probability, bound, _), value in zip(symbols, values, strict=True)
    ]


def of_constriction(symbols: list[Symbol]) -> bytes:
    coder = stream.queue.RangeEncoder()
    for probability, bound, value in symbols:
        if not bound:
            coder.encode(value, stream.model.Bernoulli(probability, perfect=False))
        elif bound > 1:
            coder.encode(value, stream.model.Uniform(bound))
    return bytes(coder.get_compressed().astype(">u4").tobytes()).rstrip(b"\0") or b"\0"


def of_reference(symbols: list[Symbol]) -> bytes:
    return reference.as_bytes(
        [
            reference.of_number(bound, value) if bound else reference.of_decision(probability, value)
            for probability, bound, value in symbols
            if bound != 1
        ]
    )


@pytest.mark.nojit
@given(SYMBOLS)
def test_symbols_come_back(symbols: list[Symbol]) -> None:
    """What was written is read again; the bytes are those of the twin and of the library."""
    writer = RangeCoder.writer()
    assert coded(writer, symbols) == symbols
    data = writer.to_bytes()
    assert data == of_reference(symbols) == of_constriction(symbols)
    reader = RangeCoder.reader(data)
    unknown = [(probability, bound, 0) for probability, bound, _ in symbols]
    assert coded(reader, unknown) == symbols
    reader.check()


@given(
    st.one_of(st.binary(max_size=40), st.lists(st.sampled_from(b"\x00\x7f\x80\xff"), max_size=40).map(bytes)),
    SYMBOLS,
)
@settings(max_examples=300)
def test_any_bytes_are_read_or_refused(data: bytes, symbols: list[Symbol]) -> None:
    """Arbitrary bytes are refused, or say what can be written and read again; many carries among them."""
    reader = RangeCoder.reader(data)
    read = coded(reader, symbols)
    assert all(0 <= value < max(bound, 2) for _, bound, value in read)
    try:
        reader.check()
    except BitstreamError:
        return
    writer = RangeCoder.writer()
    coded(writer, read)
    with (
        nullcontext()
        if data == writer.to_bytes(shortest=True)
        else pytest.raises(BitstreamError, match="end")
    ):
        reader.check_end(data)
    assert writer.to_bytes() == of_reference(read)
    assert coded(RangeCoder.reader(writer.to_bytes()), symbols) == read
    short = writer.to_bytes(shortest=True)
    again = RangeCoder.reader(short)
    assert coded(again, symbols) == read
    again.check_end(short)
    assert len(short) <= len(writer.to_bytes()) + 1


@pytest.mark.parametrize("count", [40, 150, 400])
def test_a_carry_goes_through_many_words(count: int) -> None:
    """An interval on both sides of one half is 7f ff ff and so on, until a last decision says on which."""
    straddling = coded(RangeCoder.reader(b"\x80"), [(0.3, 0, 0)] * count)
    for last, first_byte in ((1, 0x80), (0, 0x7F)):
        symbols = [*straddling, (1e-7 if last else 1 - 1e-7, 0, last)]
        writer = RangeCoder.writer()
        coded(writer, symbols)
        data = writer.to_bytes()
        assert data == of_reference(symbols) == of_constriction(symbols)
        assert data[0] == first_byte
        assert coded(RangeCoder.reader(data), symbols) == symbols


def test_data_that_cannot_have_been_written_are_refused() -> None:
    reader = RangeCoder.reader(b"\xff" * 8)
    with pytest.raises(BitstreamError, match="damaged"):
        reader.uniform(7)
    with pytest.raises(BitstreamError, match="damaged"):
        reader.uniform(7)


def test_nothing_is_one_byte() -> None:
    """Without symbols, and with numbers that can only be 0, there is one byte."""
    writer = RangeCoder.writer()
    assert writer.uniform(1) == 0
    assert writer.to_bytes() == b"\0"


def test_more_than_the_room_is_noticed() -> None:
    """Compiled functions that write more than they asked room for damage nothing, but there are no bytes."""
    writer = RangeCoder.writer()
    state = writer.room_for(1)
    for _ in range(2 * state.words.size):
        code_uniform(state, 2**24, 5)
    with pytest.raises(AssertionError, match="room"):
        writer.to_bytes()
    with pytest.raises(AssertionError, match="read"):
        RangeCoder.reader(b"\0").to_bytes()


def test_room_is_known() -> None:
    """There is room for what was asked for until it is used up, and always for a reader."""
    writer = RangeCoder.writer()
    state = writer.room_for(100)
    assert has_room(state, 100)
    while has_room(state, 1):
        code_uniform(state, 2**24, 5)
    assert int(state.fields[POSITION]) == state.words.size
    assert has_room(writer.room_for(1), 1)
    assert has_room(RangeCoder.reader(b"\0").room_for(0), 1000)


def test_a_sequence_takes_its_information() -> None:
    rng = np.random.default_rng(1)
    decisions = (rng.random(20_000) < 0.02).astype(int).tolist()
    writer = RangeCoder.writer()
    coded(writer, [(0.02, 0, decision) for decision in decisions])
    ones = sum(decisions)
    ideal_bits = -ones * np.log2(0.02) - (len(decisions) - ones) * np.log2(0.98)
    assert ideal_bits - 8 < 8 * len(writer.to_bytes()) < ideal_bits + 40


@pytest.mark.nojit
@given(st.lists(DECISIONS, min_size=1, max_size=60), st.integers(0, 40), st.binary(min_size=16, max_size=16))
def test_settled_decisions_do_not_depend_on_what_follows(
    symbols: list[Symbol], length: int, following: bytes
) -> None:
    """Decisions that a part of the data settles are right, whatever follows; all data settle all."""
    writer = RangeCoder.writer()
    coded(writer, symbols)
    whole = writer.to_bytes() + bytes(12)
    data = whole[:length]
    reader, other = RangeCoder.reader(data).room_for(0), RangeCoder.reader(data + following).room_for(0)
    for number, (probability, _, decision) in enumerate(symbols):
        if not is_settled(reader, probability, len(data)):
            assert len(data) < len(whole), number
            break
        assert code_decision(other, probability, 0) == decision
        assert code_decision(reader, probability, 0) == decision
