"""The resumable stream as a state machine: bytes come out once and in order, whatever connections do."""

import zlib
from contextlib import suppress
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvc.errors import FeedbackError
from dvc.feedback.resumable import MAX_PIECE_BYTES, MAX_UNTOLD_BYTES, Checks, ResumableStream


@dataclass
class End:
    """One end, what it has said and what it has got, and bytes on their way to it."""

    stream: ResumableStream = field(default_factory=ResumableStream)
    said: bytes = b""
    got: bytes = b""
    coming: bytearray = field(default_factory=bytearray)


class Pair:
    """Two ends with a connection between them."""

    def __init__(self) -> None:
        self.ends = End(), End()
        self.num_connections = 0
        self.connect()

    def connect(self) -> None:
        """Lose what is on its way, and go on with a new connection."""
        self.num_connections += 1
        checks = Checks(2 * self.num_connections, 2 * self.num_connections + 1)
        counts = [end.stream.num_received for end in self.ends]
        for end, count, begin in zip(self.ends, counts[::-1], (checks, Checks(*checks[::-1])), strict=True):
            end.coming.clear()
            end.stream.begin(count, begin)

    def say(self, number: int, data: bytes) -> None:
        self.ends[number].stream.keep(data)
        self.ends[number].said += data

    def carry(self, number: int, num_bytes: int, sign_of_life: bool = False) -> None:
        """Send what there is, and let so many bytes of it arrive."""
        sender, receiver = self.ends[number], self.ends[1 - number]
        while pieces := sender.stream.pieces(sign_of_life):
            sign_of_life = False
            receiver.coming += pieces
        raw = bytes(receiver.coming[:num_bytes])
        del receiver.coming[:num_bytes]
        receiver.got += receiver.stream.receive(raw)


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("say"), st.integers(0, 1), st.binary(min_size=1, max_size=60)),
        st.tuples(st.just("say"), st.integers(0, 1), st.just(bytes(range(256)) * 200)),
        st.tuples(st.just("carry"), st.integers(0, 1), st.integers(0, 40000)),
        st.tuples(st.just("sign"), st.integers(0, 1), st.integers(0, 200)),
        st.tuples(st.just("cut"), st.just(0), st.just(0)),
    ),
    max_size=40,
)


@settings(max_examples=150, deadline=None)
@given(steps=STEPS)
def test_bytes_come_out_once_and_in_order(steps: list[tuple[str, int, bytes | int]]) -> None:
    """Wherever connections are cut, and however little arrives at a time."""
    pair = Pair()
    for what, number, value in steps:
        if isinstance(value, bytes):
            pair.say(number, value)
        elif what == "cut":
            pair.connect()
        else:
            pair.carry(number, value, what == "sign")
        for end, other in (pair.ends, pair.ends[::-1]):
            assert end.said.startswith(other.got)
            assert len(other.got) + end.stream.num_kept >= len(end.said)
    for _ in range(2):
        for number in (0, 1):
            pair.carry(number, 10**9, sign_of_life=True)
    for end, other in (pair.ends, pair.ends[::-1]):
        assert other.got == end.said
        assert end.stream.num_kept == 0
    if not any(what == "cut" for what, _, _ in steps):
        assert pair.ends[0].stream.num_bytes_again == 0


@settings(max_examples=150, deadline=None)
@given(
    data=st.lists(st.binary(max_size=40), min_size=1, max_size=5),
    place=st.integers(0, 10**6),
    change=st.sampled_from(["flip", "drop", "repeat", "swap"]),
    bit=st.integers(0, 7),
    at_once=st.booleans(),
)
def test_what_was_changed_never_comes_out(
    data: list[bytes], place: int, change: str, bit: int, at_once: bool
) -> None:
    """A flipped bit, a piece that lacks, comes twice or too early: what came before is not lost by it."""
    pair = Pair()
    pieces = []
    for part in data:
        pair.say(0, part)
        pieces.append(pair.ends[0].stream.pieces(sign_of_life=True))
    number = place % len(pieces)
    if change == "flip":
        changed = bytearray(pieces[number])
        changed[place % len(changed)] ^= 1 << bit
        pieces[number] = bytes(changed)
    elif change == "drop":
        del pieces[number]
    elif change == "repeat":
        pieces.insert(number, pieces[number])
    else:
        pieces[0], pieces[number] = pieces[number], pieces[0]
    receiver, got = pair.ends[1].stream, b""
    with suppress(FeedbackError):
        for piece in [b"".join(pieces)] if at_once else pieces:
            got += receiver.receive(piece)
    assert pair.ends[0].said.startswith(got)
    assert receiver.num_received == len(got)


def test_a_piece_of_another_connection_is_not_taken() -> None:
    """Not even as the first on the next one."""
    pair = Pair()
    pair.say(0, b"late")
    late = pair.ends[0].stream.pieces()
    pair.connect()
    with pytest.raises(FeedbackError, match="changed on the way"):
        pair.ends[1].stream.receive(late)


@pytest.mark.parametrize("count", [-1, 3, 11, 2**63])
def test_going_on_elsewhere_is_refused(count: int) -> None:
    """Before what was let go of, and after what was said; nothing changes."""
    pair = Pair()
    pair.say(0, b"0123")
    pair.carry(0, 10**6)
    pair.carry(1, 10**6, sign_of_life=True)
    pair.say(0, b"456789")
    stream = pair.ends[0].stream
    with pytest.raises(FeedbackError, match=f"after {count} bytes, not after 4 to 10"):
        stream.begin(count, Checks(0, 0))
    assert stream.num_kept == 6
    pair.carry(0, 10**6)
    assert pair.ends[1].got == b"0123456789"


def test_a_peer_cannot_acknowledge_what_was_not_sent() -> None:
    """Nor announce a piece that is too long."""
    for say in (b"\x00\x00\x00\x00\x00\x01", b"\x40\x01\x00\x00\x00\x00"):
        stream = ResumableStream()
        stream.begin(0, Checks(1, 2))
        with pytest.raises(FeedbackError, match="breaks the protocol"):
            stream.receive(say + zlib.crc32(say, 2).to_bytes(4, "big"))


def test_much_is_acknowledged_at_once() -> None:
    """So that the other side can let go of it; little waits for what is sent anyway."""
    pair = Pair()
    pair.say(0, bytes(MAX_UNTOLD_BYTES))
    pair.carry(0, 10**6)
    assert not pair.ends[1].stream.is_owing
    pair.say(0, b"x")
    pair.carry(0, 10**6)
    assert pair.ends[1].stream.is_owing
    pair.carry(1, 10**6, sign_of_life=True)
    assert not pair.ends[1].stream.is_owing
    assert pair.ends[0].stream.num_kept == 0


def test_pieces_are_bounded() -> None:
    """What is lost with one that is damaged is little."""
    pair = Pair()
    pair.say(0, bytes(10 * MAX_PIECE_BYTES + 1))
    pieces = pair.ends[0].stream.pieces()
    assert len(pieces) == 10 * MAX_PIECE_BYTES + 1 + 11 * 14
    assert len(pair.ends[1].stream.receive(pieces[: MAX_PIECE_BYTES + 14])) == MAX_PIECE_BYTES


def test_bytes_sent_again_are_counted() -> None:
    """Those that were on a connection that was lost, from where the other side goes on."""
    pair = Pair()
    pair.say(0, b"0123456789")
    assert pair.ends[0].stream.pieces()
    pair.connect()
    assert pair.ends[0].stream.num_bytes_again == 10
    pair.carry(0, 10**6)
    pair.connect()
    assert pair.ends[0].stream.num_bytes_again == 10
