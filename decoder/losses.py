"""What damage costs: frames of a stream that cannot be decoded, and why."""

from contextlib import suppress
from typing import Protocol

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
    """Frames that are lost, in order of display."""

    def __init__(self) -> None:
        self.num_frames = 0
        self._runs: list[tuple[range, str]] = []
        self._end = ""

    def add(self, frames: range, reason: BitstreamError | str) -> None:
        """Note frames that are lost; those of one run have the reason of the first."""
        self.num_frames += len(frames)
        before, why = self._runs[-1] if self._runs else (range(-1), "")
        if frames and before.stop == frames.start:
            self._runs[-1] = range(before.start, frames.stop), why
        elif frames:
            self._runs.append((frames, str(reason)))

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
        """Return what says what is lost, if anything is."""
        named = [
            f"frames {run.start} to {run.stop - 1}: {why}" if len(run) > 1 else f"frame {run.start}: {why}"
            for run, why in self._runs[:MAX_NAMED]
        ]
        named += [f"{len(self._runs) - MAX_NAMED} more runs of frames"] * (len(self._runs) > MAX_NAMED)
        named += [self._end] * bool(self._end)
        if not named:
            return None
        return BitstreamError(f"lost: {'; '.join(named)} (frames kept: {num_kept})")
