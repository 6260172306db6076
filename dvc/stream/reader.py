"""Reading of streams, one group of pictures at a time; nothing in a stream is trusted."""

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from dvc.bits import MAX_VARINT_BYTES, decode_varint
from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.files import Closing
from dvc.stream.gop import GopRecord, decode_gop, decode_head
from dvc.stream.records import (
    CRC_BYTES,
    FORMAT_VERSION,
    MAGIC,
    MAX_GOPS,
    SIZE_BYTES,
    TRAILER_BYTES,
    Form,
    IndexEntry,
    RecordPosition,
    RecordType,
    StreamIndex,
    check_payload_size,
    decode_configuration,
    decode_end,
    framed_size,
    record_crc,
)

_CHUNK_BYTES = 2**20  # largest read before more memory is spent on a record


class _StreamEnds(BitstreamError):
    """The stream ends too early; the data before the end are valid."""


class _RecordSource:
    """Reads records from a file or a pipe."""

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self.position = 0
        self.size: int | None = None  # size of the whole stream, None for a pipe
        if file.seekable():
            self.size = file.seek(0, os.SEEK_END)
            file.seek(0)

    def seek(self, position: int) -> None:
        self.file.seek(position)
        self.position = position

    def read(self, count: int) -> bytes:
        """Read `count` bytes, fewer only at the end of the stream; memory grows with the data that arrive."""
        parts = []
        while count > 0:
            try:
                part = self.file.read(min(count, _CHUNK_BYTES))
            except OSError as err:
                raise BitstreamError(f"cannot read byte {self.position}: {err.strerror or err}") from err
            if not part:
                break
            parts.append(part)
            count -= len(part)
            self.position += len(part)
        return b"".join(parts)

    def read_head(self, number: int | None) -> tuple[RecordPosition, int, bytes]:
        """Return the position of a record, the size of its payload, and the bytes of its type and length."""
        record_at = RecordPosition(number, self.position)
        head = self.read(1)
        if not head:
            raise _StreamEnds(record_at.message("the stream ends without its end record"))
        try:
            record_at = RecordPosition(number, record_at.offset, RecordType(head[0]))
        except ValueError as err:
            raise record_at.error(f"unknown type {head[0]}") from err
        assert record_at.type is not None
        while len(head) <= MAX_VARINT_BYTES:
            byte = self.read(1)
            head += byte
            if not byte or byte[0] < 0x80:
                break
        try:
            size, _ = decode_varint(head, 1)
        except BitstreamError as err:
            kind = BitstreamError if byte else _StreamEnds
            raise kind(record_at.message(f"length: {err}")) from err
        check_payload_size(record_at.type, size, record_at)
        if self.size is not None and size + CRC_BYTES > self.size - self.position:
            left = max(self.size - self.position, 0)
            raise _StreamEnds(record_at.message(f"{size + CRC_BYTES} bytes promised, {left} left"))
        return record_at, size, head

    def read_record(self, number: int | None) -> tuple[RecordPosition, bytes]:
        """Read the next record and check its CRC-32."""
        record_at, size, head = self.read_head(number)
        payload, crc = self.read(size), self.read(CRC_BYTES)
        if len(payload) < size or len(crc) < CRC_BYTES:
            raise _StreamEnds(record_at.message("the stream ends within the record"))
        if crc != record_crc(head, payload):
            raise record_at.error("checksum mismatch")
        return record_at, payload


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
        self._owned = isinstance(source, (str, os.PathLike))
        self._source = _RecordSource(_open(source))
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
            self.config, self.form = decode_configuration(payload)
        except BitstreamError as err:
            raise record_at.error(str(err)) from err

    def __iter__(self) -> Iterator[GopRecord]:
        return self

    def __next__(self) -> GopRecord:
        if self._done:
            raise StopIteration
        self._done = True  # unless this record is a GOP
        offset = self._source.position
        try:
            record_at, payload = self._source.read_record(len(self._seen) + 1)
        except _StreamEnds as err:
            self._miss(self._seen, err)
            raise StopIteration from err
        try:
            if record_at.type is RecordType.END:
                self._check_end(payload)
                raise StopIteration
            record = self._accept_gop(record_at, payload)
        except BitstreamError as err:
            raise record_at.error(str(err)) from err
        number, entry = len(self._seen), IndexEntry(offset, self._source.position - offset, record.num_frames)
        self._seen.append(entry)
        if self._index is not None and self._index.entries[number : number + 1] != (entry,):
            raise record_at.error("the index does not agree with the record")
        self._done = False
        return record

    def _accept_gop(self, record_at: RecordPosition, payload: bytes) -> GopRecord:
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
        return record

    def _miss(self, finished: Sequence[IndexEntry], end: _StreamEnds) -> None:
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
        if entries is not None and entries != tuple(self._seen):
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
            raise record_at.error(str(err)) from err
        assert entries is not None
        if self._first_offset + sum(entry.size for entry in entries) != end_offset:
            raise record_at.error("the index does not agree with the records")
        return StreamIndex(num_frames, entries)

    def _hop(self) -> StreamIndex:
        """Build the index from the lengths of the records, without their payloads."""
        source = self._source
        source.seek(self._first_offset)
        entries: list[IndexEntry] = []
        while True:
            try:
                record_at, size, head = source.read_head(len(entries) + 1)
            except _StreamEnds as err:
                self._miss(entries, err)
                break
            if record_at.type is not RecordType.GOP or len(entries) == MAX_GOPS:
                break
            beginning = source.read(min(size, MAX_VARINT_BYTES))
            try:
                num_frames = decode_head(beginning).num_frames
            except BitstreamError as err:
                raise record_at.error(str(err)) from err
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


def _open(source: BinaryIO | str | os.PathLike[str]) -> BinaryIO:
    if not isinstance(source, (str, os.PathLike)):
        return source
    try:
        return Path(source).open("rb")
    except OSError as err:
        raise BitstreamError(f"cannot read {source}: {err.strerror}") from err
