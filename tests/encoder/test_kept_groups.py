"""Which groups are kept for a decoder that comes in place of another one."""

from dvc.stream import Deviations, GopRecord
from encoder.kept_groups import KeptGroup, KeptGroups
from encoder.session import EncodedGroup


class Sequence:
    """Groups of so many frames, as they are sent."""

    def __init__(self, max_frames: int = 100) -> None:
        self.kept = KeptGroups(max_frames)
        self.groups: list[KeptGroup] = []

    def send(self, num_frames: int, predicted: bool = False) -> None:
        record = GopRecord(num_frames, b"k", predicted, b"t", (b"p",) * (num_frames - 1))
        first = self.groups[-1].end_frame if self.groups else 0
        self.groups.append(KeptGroup(len(self.groups), first, EncodedGroup(record, ())))
        self.kept.add(self.groups[-1])

    def done(self, *numbers: int) -> None:
        for number in numbers:
            self.groups[number].done = True
        self.kept.drop_done()

    def again(self) -> list[tuple[int, int, int]]:
        """Return number, first frame and length of what another decoder is sent."""
        found = [(group.number, group.first_frame, group.encoded.record) for group in self.kept.begin_again()]
        return [(number, first, record.num_frames) for number, first, record in found]


def sent(max_frames: int = 100) -> Sequence:
    """Return an IDR picture, and five groups of four frames that end with one."""
    sequence = Sequence(max_frames)
    sequence.send(1)
    for _ in range(5):
        sequence.send(4)
    return sequence


def test_nothing_done_begins_at_the_beginning() -> None:
    """With the first key frame, and all groups."""
    assert sent().again() == [(0, 0, 1), (1, 1, 4), (2, 5, 4), (3, 9, 4), (4, 13, 4), (5, 17, 4)]


def test_another_decoder_begins_with_an_idr_picture_before_the_last_group_that_is_done() -> None:
    """That one may be lost with who has written it. The picture comes alone, without tracks."""
    sequence = sent()
    sequence.done(0, 1, 2, 3)
    again = sequence.kept.begin_again()
    assert [(group.number, group.first_frame) for group in again] == [(2, 8), (3, 9), (4, 13), (5, 17)]
    first = again[0].encoded.record
    assert (first.num_frames, first.tracks, first.wyner_ziv) == (1, b"", ())
    assert again[1:] == sequence.groups[3:]


def test_a_chain_is_kept_from_its_idr_picture_on() -> None:
    """Though it is done: key frames that follow are predicted from it."""
    sequence = Sequence()
    sequence.send(1)
    sequence.send(4)
    for _ in range(3):
        sequence.send(4, predicted=True)
    sequence.done(0, 1, 2, 3)
    assert sequence.again() == [(1, 4, 1), (2, 5, 4), (3, 9, 4), (4, 13, 4)]


def test_the_oldest_groups_go_beyond_the_bound() -> None:
    """Then the first IDR picture that is left is the first."""
    assert sent(9).again() == [(4, 16, 1), (5, 17, 4)]
    sequence = sent(9)
    for _ in range(3):
        sequence.send(4, predicted=True)
    assert sequence.again() == []


def test_a_key_frame_alone_has_its_own_time_stamp() -> None:
    """The last one of its group, if it is off the constant rate."""
    for last, kept in ((5, Deviations(1000, (5,))), (0, None)):
        deviations = Deviations(1000, (3, 0, 7, last))
        record = GopRecord(4, b"k", False, b"t", (b"p",) * 3, deviations=deviations)
        alone = KeptGroup(1, 1, EncodedGroup(record, ())).key_alone()
        assert (alone.first_frame, alone.encoded.record.deviations) == (4, kept)
