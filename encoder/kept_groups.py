"""Groups of pictures that a live encoder keeps for a decoder that comes in place of one that is gone."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

from encoder.session import EncodedGroup


@dataclass
class KeptGroup:
    """A group of pictures that was sent, and may be sent again."""

    number: int  # of the group in the sequence
    first_frame: int  # of the sequence
    encoded: EncodedGroup
    done: bool = False  # whether a decoder has written it

    @property
    def begins_chain(self) -> bool:
        """Whether its key frame is an IDR picture."""
        return not self.encoded.record.predicted

    @property
    def end_frame(self) -> int:
        """Number of the first frame after it."""
        return self.first_frame + self.encoded.record.num_frames

    def key_alone(self) -> "KeptGroup":
        """Return its key frame, with which a decoder can begin."""
        record = self.encoded.record
        late = None if record.deviations is None else record.deviations.of_last()
        record = replace(record, num_frames=1, tracks=b"", wyner_ziv=(), deviations=late)
        return KeptGroup(self.number, self.end_frame - 1, EncodedGroup(record, ()), self.done)


class KeptGroups:
    """The latest groups, from an IDR picture on before all frames that no decoder has written for sure."""

    def __init__(self, max_frames: int) -> None:
        self._max_frames = max_frames
        self._groups: deque[KeptGroup] = deque()

    def add(self, group: KeptGroup) -> None:
        """Keep a group; beyond the bound the oldest ones go."""
        self._groups.append(group)
        while self._groups[-1].end_frame - self._groups[0].first_frame > self._max_frames:
            self._groups.popleft()

    def drop_done(self) -> None:
        """Let go of what nobody can want any more."""
        for _ in range(self._start(self._groups)):
            self._groups.popleft()

    @staticmethod
    def _start(groups: Iterable[KeptGroup]) -> int:
        """Return the place of the last group with an IDR picture before the last group that is done.

        That one counts for nothing: what a decoder writes last may be lost with it.
        """
        start = 0
        for place, (group, after) in enumerate(pairwise(groups)):
            if not after.done:
                break
            if group.begins_chain:
                start = place
        return start

    def begin_again(self) -> list[KeptGroup]:
        """Return what another decoder is sent first, from an IDR picture alone on; nothing without any."""
        groups = list(self._groups)[self._start(self._groups) :]
        while groups and not groups[0].begins_chain:
            del groups[0]
        self._groups = deque(groups)
        return [groups[0].key_alone(), *groups[1:]] if groups else []
