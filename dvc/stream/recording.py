"""A recording as one stream: segments of an encoder, read one after the other."""

import os
from bisect import bisect_right
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.files import PARTIAL_SUFFIX, Closing, natural_key
from dvc.stream.gop import Deviations, GopRecord, following
from dvc.stream.reader import StreamReader
from dvc.stream.records import Form, IndexEntry, StreamIndex

STREAM_SUFFIX = ".dvc"


class RecordingReader(Closing):
    """Reads the segments of a recording as one stream, as `StreamReader` reads a file.

    Groups of pictures and frames are counted through all segments, and the index is that of all of them. No
    more than one segment is open at a time.

    Parameters
    ----------
    folder : path
        Folder of segments, files ``*.dvc`` in natural order of their names.
    unfinished : bool, optional
        Whether segments may end before their end records; files with names that end in ``.part`` are read,
        too. `missing` lists the missing parts.

    Raises
    ------
    BitstreamError
        If the folder has no segment, or a segment has another configuration than the first.
    """

    config: CodecConfig
    form: Form

    def __init__(self, folder: str | os.PathLike[str], *, unfinished: bool = False) -> None:
        self._unfinished = unfinished
        self._missing: list[str] = []
        self._paths: list[Path] = []
        self._index: StreamIndex | None = None
        self._starts: list[int] = []  # number of the first GOP of each segment, once the index is read
        self.num_bytes = 0  # size of all segments
        for path in _segments(Path(folder), unfinished):
            with _naming(path):
                self._add(path)
        if not self._paths:
            raise BitstreamError("a folder without segments (*.dvc)")
        self._records = self._read()

    def _add(self, path: Path) -> None:
        """Add a segment, unless it is unfinished and has no group of pictures yet."""
        try:
            with StreamReader(path, unfinished=self._unfinished) as reader:
                if path.suffix == PARTIAL_SUFFIX:
                    reader.seek_gop(0)  # fails if it has none
        except BitstreamError as err:
            if path.suffix != PARTIAL_SUFFIX:
                raise
            self._missing.append(f"{path.name}: {err}")
            return
        if not self._paths:
            self.config, self.form = reader.config, reader.form
        elif (reader.config, reader.form) != (self.config, self.form):
            raise BitstreamError(f"its configuration differs from that of {self._paths[0].name}")
        self._paths.append(path)
        self.num_bytes += reader.num_bytes

    def __iter__(self) -> Iterator[GopRecord]:
        return self._records

    def _read(self, segment: int = 0, gop: int = 0) -> Generator[GopRecord]:
        last: Deviations | None = None  # deviations of the last group, relative to the first segment
        for path in self._paths[segment:]:
            before = last
            with _naming(path), StreamReader(path, unfinished=self._unfinished) as reader:
                if gop:
                    reader.seek_gop(gop)
                    gop = 0
                for record in reader:
                    last = following(before, record.deviations, record.num_frames)
                    yield replace(record, deviations=last)
                if reader.missing is not None:
                    self._missing.append(f"{path.name}: {reader.missing}")

    @property
    def missing(self) -> str | None:
        """Missing parts of unfinished segments, once they are reached."""
        return "; ".join(self._missing) or None

    @property
    def num_frames(self) -> int:
        """Number of frames that the end records of all segments state; 0 if one is damaged."""
        with suppress(BitstreamError):
            return self.index.num_frames
        return 0

    @property
    def index(self) -> StreamIndex:
        """All groups of pictures, each with its offset in its segment."""
        if self._index is None:
            entries: list[IndexEntry] = []
            for path in self._paths:
                with _naming(path), StreamReader(path, unfinished=self._unfinished) as reader:
                    self._starts.append(len(entries))
                    entries += reader.index.entries
            self._index = StreamIndex(sum(entry.num_frames for entry in entries), tuple(entries))
        return self._index

    def seek_gop(self, number: int) -> None:
        """Continue with a GOP by its number from 0; the number of GOPs is the end of the recording."""
        num_gops = len(self.index.entries)
        if not 0 <= number <= num_gops:
            raise ValueError(f"`number` must be from 0 to {num_gops}, got {number}")
        segment = bisect_right(self._starts, number) - 1
        self._records.close()
        self._records = self._read(segment, number - self._starts[segment])

    def close(self) -> None:
        """Close the segment that is open."""
        self._records.close()


def open_stream(path: str, *, unfinished: bool = False) -> StreamReader | RecordingReader:
    """Open a stream, or a folder of segments."""
    opened = RecordingReader if Path(path).is_dir() else StreamReader
    return opened(path, unfinished=unfinished)


def _segments(folder: Path, unfinished: bool) -> list[Path]:
    suffixes = (STREAM_SUFFIX, STREAM_SUFFIX + PARTIAL_SUFFIX) if unfinished else (STREAM_SUFFIX,)
    try:
        entries = list(folder.iterdir())
    except OSError as err:
        raise BitstreamError(f"cannot be read ({err.strerror})") from err
    segments = [path for path in entries if path.name.endswith(suffixes) and not path.name.startswith(".")]
    return sorted(segments, key=natural_key)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Prefix errors with the name of a segment."""
    try:
        yield
    except BitstreamError as err:
        raise BitstreamError(f"{path.name}: {err}") from err
