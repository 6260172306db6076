"""A recording as segments: numbered files, each a complete stream with a fixed number of frames."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, count, islice
from pathlib import Path
from typing import TYPE_CHECKING

from dvc.errors import ConfigError
from dvc.files import PARTIAL_SUFFIX, growing_output
from dvc.video import Frame

if TYPE_CHECKING:
    from encoder.encoder_report import EncoderStatistics
    from encoder.encoder_session import EncoderSession, Progress

MIN_DIGITS = 4
MAX_SEGMENT_FRAMES = 10**9
CONVERSION = re.compile(r"%(0[1-9])?d")


@dataclass(frozen=True)
class SegmentNames:
    """Names of segments: a number with a least count of digits between two texts."""

    folder: Path
    before: str
    num_digits: int
    after: str

    def path(self, number: int) -> Path:
        """Return the name of a segment."""
        return self.folder / f"{self.before}{number:0{self.num_digits}d}{self.after}"

    def existing(self) -> dict[int, Path]:
        """Return existing segments by number, finished or not."""
        before, after = re.escape(self.before), re.escape(self.after)
        pattern = re.compile(f"{before}([0-9]{{{self.num_digits},9}}){after}({re.escape(PARTIAL_SUFFIX)})?")
        matches = ((pattern.fullmatch(path.name), path) for path in sorted(self.folder.iterdir()))
        return {int(match[1]): path for match, path in matches if match is not None}


def segment_names(output: str) -> SegmentNames:
    """Read the pattern of the names of segments."""
    path = Path(output)
    parts = CONVERSION.split(path.name)
    if len(parts) == 3 and not any("%" in part for part in parts[::2]):
        return SegmentNames(path.parent, parts[0], int(parts[1] or 1), parts[2])
    if "%" in path.name:
        raise ConfigError(f"names of segments need one number such as %04d, got {output!r}")
    return SegmentNames(path.parent, f"{path.stem}-", MIN_DIGITS, path.suffix)


@dataclass(frozen=True)
class Segment:
    """A finished segment."""

    path: Path
    statistics: "EncoderStatistics"
    limits: Mapping[str, int]  # report of the limiter


def write_segments(
    frames: Iterable[Frame | None],
    names: SegmentNames,
    num_frames: int,
    new_session: Callable[[], "EncoderSession"],
    progress: "Progress",
) -> Iterator[Segment]:
    """Encode a recording segment by segment; each starts with a key frame."""
    source, before = iter(frames), None
    for number in count(max(names.existing(), default=-1) + 1):
        first = next(source, None)
        if first is None:
            return
        session = new_session()
        if session.limiter is not None and before is not None:
            session.limiter.continue_from(before)
        before = session.limiter
        with growing_output(names.path(number)) as file:
            session.write(chain([first], islice(source, num_frames - 1)), file, progress)
        limits = {} if session.limiter is None else session.limiter.report()
        yield Segment(names.path(number), session.statistics, limits)
