"""What damage costs: frames of a stream that cannot be decoded, and why."""

import sys
from contextlib import suppress
from typing import Protocol

from decoder.tasks import DecodedGroup, GroupTask
from dvc.errors import BitstreamError
from dvc.stream import GopRecord, StreamIndex

MAX_NAMED = 20
"""Runs of lost frames that a message names; further ones are counted."""


class Resumable(Protocol):
    """A reader that can go on behind a damaged group of pictures."""

    @property
    def index(self) -> StreamIndex:
        """All groups of pictures."""

    def seek_gop(self, number: int) -> None:
        """Go on reading with a certain group."""


class Losses:
    """Frames that are lost, of those that are wanted."""

    def __init__(self, wanted: range | None = None) -> None:
        self._wanted = range(sys.maxsize) if wanted is None else wanted
        self._runs: list[tuple[range, str]] = []
        self._end = ""

    def add(self, frames: range, reason: BitstreamError | str) -> None:
        """Note frames that are lost, and why."""
        first, stop = max(frames.start, self._wanted.start), min(frames.stop, self._wanted.stop)
        if first < stop:
            self._runs.append((range(first, stop), str(reason)))

    def rest_of(self, task: GroupTask, damage: BitstreamError) -> DecodedGroup:
        """Note the Wyner-Ziv frames of a damaged group; return its key frame."""
        self.add(range(task.first_index, task.last_index), damage)
        return DecodedGroup.of(task.key_alone(), [])

    def pass_over(self, reader: Resumable, number: int, damage: BitstreamError) -> GopRecord | None:
        """Go on reading behind a damaged group; return what is left of it, or none if nothing follows."""
        with suppress(BitstreamError):
            entries = reader.index.entries
            if number < len(entries):
                reader.seek_gop(number + 1)
                num_frames = entries[number].num_frames
                return GopRecord(num_frames, b"", wyner_ziv=(b"",) * (num_frames - 1))
        self._end = str(damage)
        return None

    def error(self, num_kept: int) -> BitstreamError | None:
        """Return what says what is lost, if anything is: runs of frames in order of display."""
        runs: list[tuple[range, str]] = []
        for frames, why in sorted(self._runs, key=lambda run: run[0].start):
            if runs and runs[-1][0].stop == frames.start:  # for the reason of the first
                runs[-1] = range(runs[-1][0].start, frames.stop), runs[-1][1]
            else:
                runs.append((frames, why))
        named = [
            f"frames {run.start} to {run.stop - 1}: {why}" if len(run) > 1 else f"frame {run.start}: {why}"
            for run, why in runs[:MAX_NAMED]
        ]
        named += [f"{len(runs) - MAX_NAMED} more runs of frames"] * (len(runs) > MAX_NAMED)
        named += [self._end] * bool(self._end)
        return BitstreamError(f"lost: {'; '.join(named)} (frames kept: {num_kept})") if named else None
