"""Reading of streams and recordings, one group of pictures at a time; nothing in a stream is trusted."""

import os
from bisect import bisect_right
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from dvc.bits import MAX_VARINT_BYTES
from dvc.config import CodecConfig, decode_config
from dvc.errors import BitstreamError
from dvc.files import PARTIAL_SUFFIX, Closing, natural_key
from dvc.stream.gop import Deviations, GopRecord, decode_gop, decode_head, following
from dvc.stream.records import (
    CRC_BYTES,
    FORMAT_VERSION,
    FORMS,
    MAGIC,
    MAX_GOPS,
    SIZE_BYTES,
    TRAILER_BYTES,
    Form,
    IndexEntry,
    RecordSource,
    RecordType,
    StreamEnds,
    StreamIndex,
    decode_end,
    framed_size,
)

STREAM_SUFFIX = ".dvc"


class StreamReader(Closing):
    """Reads a stream; the counterpart of `StreamWriter`.

    Iteration yields every `GopRecord` in order of display and then checks the end of the stream. All GOPs
    before damage are yielded, then `BitstreamError` reports its position.

    Parameters
    ----------
    source : binary file or path
        A stream from its first byte on; a pipe will do for iteration. A file that was passed in stays open.
    unfinished : bool, optional
        Whether the stream may end before its end record, as one that is still being written: all GOPs that
        are complete are yielded, and `missing` reports the missing part. At least one must be complete.

    Raises
    ------
    BitstreamError
        If the header is not that of a stream that this program reads.
    """

    config: CodecConfig
    form: Form
    missing: str | None  # missing part of an unfinished stream, once it is reached

    def __init__(self, source: BinaryIO | str | os.PathLike[str], *, unfinished: bool = False) -> None:
        self.missing = None
        self._unfinished = unfinished
        self._owned = False
        if isinstance(source, (str, os.PathLike)):
            self._owned = True
            try:
                source = Path(source).open("rb")  # noqa: SIM115 -- closed by `close`
            except OSError as err:
                raise BitstreamError(f"cannot read {source}: {err.strerror}") from err
        self._source = RecordSource(source)
        self._index: StreamIndex | None = None
        self._done = False
        self._seen: list[IndexEntry] = []  # GOPs before the current position
        try:
            self._read_header()
        except BaseException:
            self.close()
            raise
        self._first_offset = self._source.position

    def _read_header(self) -> None:
        if self._source.read(len(MAGIC)) != MAGIC:
            raise BitstreamError("not a dvc3d stream")
        version = self._source.read(1)
        if version != bytes([FORMAT_VERSION]):
            found = version[0] if version else "missing"
            maker = ", made by a version of dvc3d before 2" if found == 1 else ""
            raise BitstreamError(
                f"format version {found}{maker}; this program reads version {FORMAT_VERSION}"
            )
        record_at, payload = self._source.read_record(0)
        if record_at.type is not RecordType.CONFIGURATION:
            raise record_at.error("the first record must be the configuration")
        try:
            if not payload or payload[0] not in FORMS:
                raise BitstreamError("unknown form; known are buffered, punctured and no-feedback")
            self.config, self.form = decode_config(payload[1:]), FORMS[payload[0]]
        except BitstreamError as err:
            raise record_at.error(err) from err

    def __iter__(self) -> Iterator[GopRecord]:
        return self

    def __next__(self) -> GopRecord:
        if self._done:
            raise StopIteration
        self._done = True  # unless this record is a GOP
        offset = self._source.position
        try:
            record_at, payload = self._source.read_record(len(self._seen) + 1)
        except StreamEnds as err:
            self._miss(self._seen, err)
            raise StopIteration from err
        try:
            if record_at.type is RecordType.END:
                self._check_end(payload)
                raise StopIteration
            if record_at.type is not RecordType.GOP:
                raise BitstreamError("the configuration must come first and once")
            if len(self._seen) == MAX_GOPS:
                raise BitstreamError(f"more than {MAX_GOPS} groups of pictures")
            record = decode_gop(payload, self.form is Form.PUNCTURED)
            limit = self.config.gop.length if self._seen else 1
            if record.num_frames > limit:
                raise BitstreamError(f"{record.num_frames} frames, at most {limit} are allowed")
            if record.predicted and not (self._seen and self.config.key.predicted):
                raise BitstreamError("a predicted key frame has no reference here")
        except BitstreamError as err:
            raise record_at.error(err) from err
        number, entry = len(self._seen), IndexEntry(offset, self._source.position - offset, record.num_frames)
        self._seen.append(entry)
        if self._index is not None and self._index.entries[number : number + 1] != (entry,):
            raise record_at.error("the index does not agree with the record")
        self._done = False
        return record

    def _miss(self, finished: Sequence[IndexEntry], end: StreamEnds) -> None:
        """Record the missing end of an unfinished stream; raise it for any other stream."""
        if not (self._unfinished and finished):
            raise end
        num_frames = sum(entry.num_frames for entry in finished)
        self.missing = f"{end} (groups of pictures before it: {len(finished)}, frames: {num_frames})"

    def _check_end(self, payload: bytes) -> None:
        num_frames, entries = decode_end(payload, self.form, self._first_offset, len(self._seen))
        found = sum(entry.num_frames for entry in self._seen)
        if num_frames != found:
            raise BitstreamError(f"{num_frames} frames promised, {found} found")
        if entries is not None and entries != self._seen:
            raise BitstreamError("the index does not agree with the records")
        if self._source.read(1):
            raise BitstreamError("bytes follow the end record")

    @property
    def num_bytes(self) -> int:
        """Size of the stream; for a pipe, of the data already read."""
        return self._source.position if self._source.size is None else self._source.size

    @property
    def num_frames(self) -> int:
        """Number of frames that the end of the stream states; otherwise of those already read."""
        if self._source.size is not None:
            with suppress(BitstreamError):
                return self.index.num_frames
        return sum(entry.num_frames for entry in self._seen)

    @property
    def index(self) -> StreamIndex:
        """Index of all GOPs: read from the end of a buffered stream, else by seeking from GOP to GOP."""
        if self._index is None:
            if self._source.size is None:
                raise BitstreamError("a stream from a pipe has no index; it can only be read in order")
            position = self._source.position
            has_index = self.form is Form.BUFFERED and not self._unfinished
            try:
                self._index = self._read_index() if has_index else self._hop()
            finally:
                self._source.seek(position)
        return self._index

    def _read_index(self) -> StreamIndex:
        source = self._source
        assert source.size is not None
        if source.size < self._first_offset + TRAILER_BYTES:
            raise BitstreamError("the stream ends without its end record")
        source.seek(source.size - TRAILER_BYTES)
        end_offset = source.size - int.from_bytes(source.read(SIZE_BYTES), "little")
        if not self._first_offset <= end_offset <= source.size - TRAILER_BYTES:
            raise BitstreamError("the stream ends without its end record")
        source.seek(end_offset)
        record_at, payload = source.read_record(None)
        try:
            max_gops = (end_offset - self._first_offset) // framed_size(1)
            num_frames, entries = decode_end(payload, self.form, self._first_offset, max_gops)
        except BitstreamError as err:
            raise record_at.error(err) from err
        assert entries is not None
        if self._first_offset + sum(entry.size for entry in entries) != end_offset:
            raise record_at.error("the index does not agree with the records")
        return StreamIndex(num_frames, tuple(entries))

    def _hop(self) -> StreamIndex:
        """Build the index from the lengths of the records, without their payloads."""
        source = self._source
        source.seek(self._first_offset)
        entries: list[IndexEntry] = []
        while True:
            try:
                record_at, size, head = source.read_head(len(entries) + 1)
            except StreamEnds as err:
                self._miss(entries, err)
                break
            if record_at.type is not RecordType.GOP or len(entries) == MAX_GOPS:
                break
            beginning = source.read(min(size, MAX_VARINT_BYTES))
            try:
                num_frames, *_ = decode_head(beginning)
            except BitstreamError as err:
                raise record_at.error(err) from err
            entries.append(IndexEntry(record_at.offset, framed_size(size), num_frames))
            source.seek(record_at.offset + len(head) + size + CRC_BYTES)
        if not self.missing and record_at.type is not RecordType.END:
            raise record_at.error(f"unexpected after {len(entries)} groups of pictures")
        return StreamIndex(sum(entry.num_frames for entry in entries), tuple(entries))

    def seek_gop(self, number: int) -> None:
        """Continue with a GOP by its number from 0; the number of GOPs is the end of the stream."""
        entries = self.index.entries
        if not 0 <= number <= len(entries):
            raise ValueError(f"`number` must be from 0 to {len(entries)}, got {number}")
        self._seen = list(entries[:number])
        self._source.seek(self._first_offset + sum(entry.size for entry in self._seen))
        self._done = False

    def close(self) -> None:
        """Close the file if the reader opened it."""
        if self._owned:
            self._source.file.close()


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
        suffixes = (STREAM_SUFFIX, STREAM_SUFFIX + PARTIAL_SUFFIX) if unfinished else (STREAM_SUFFIX,)
        try:
            paths = sorted(Path(folder).iterdir(), key=natural_key)
        except OSError as err:
            raise BitstreamError(f"cannot be read ({err.strerror})") from err
        for path in paths:
            if not path.name.endswith(suffixes) or path.name.startswith("."):
                continue
            with _naming(path):
                try:
                    with StreamReader(path, unfinished=self._unfinished) as reader:
                        if path.suffix == PARTIAL_SUFFIX:
                            reader.seek_gop(0)  # fails if it has no group of pictures
                except BitstreamError as err:
                    if path.suffix != PARTIAL_SUFFIX:
                        raise
                    self._missing.append(f"{path.name}: {err}")
                    continue
                if not self._paths:
                    self.config, self.form = reader.config, reader.form
                elif (reader.config, reader.form) != (self.config, self.form):
                    raise BitstreamError(f"its configuration differs from that of {self._paths[0].name}")
                self._paths.append(path)
                self.num_bytes += reader.num_bytes
        if not self._paths:
            raise BitstreamError("a folder without segments (*.dvc)")
        self._records = self._read()

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


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Prefix errors with the name of a segment."""
    try:
        yield
    except BitstreamError as err:
        raise BitstreamError(f"{path.name}: {err}") from err
