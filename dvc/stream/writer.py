"""Writing of streams, one group of pictures at a time."""

from types import TracebackType
from typing import BinaryIO, Self

from dvc.config import CodecConfig
from dvc.errors import BitstreamError
from dvc.stream.gop import GopRecord, encode_gop
from dvc.stream.records import (
    FORMAT_VERSION,
    MAGIC,
    MAX_GOPS,
    MAX_RECORD_BYTES,
    Form,
    IndexEntry,
    RecordType,
    StreamIndex,
    encode_configuration,
    encode_end,
    frame_record,
)


class StreamWriter:
    """Writes a stream; the counterpart of `StreamReader`.

    As a context manager it writes the end record if the block succeeds. The file stays open.

    Parameters
    ----------
    file : binary file
        File to write to; it need not be seekable.
    config : CodecConfig
        The codec configuration.
    form : Form or str
        ``"buffered"``, ``"punctured"`` or ``"no-feedback"``.
    """

    def __init__(self, file: BinaryIO, config: CodecConfig, form: Form | str) -> None:
        self.config = config
        self.form = Form(form)
        self.num_bytes = 0
        self.num_frames = 0
        self._file = file
        self._entries: list[IndexEntry] = []
        self._closed = False
        head = MAGIC + bytes([FORMAT_VERSION])
        self._write(head + frame_record(RecordType.CONFIGURATION, encode_configuration(config, self.form)))

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self.num_bytes += len(data)

    def write_gop(self, record: GopRecord) -> None:
        """Append a group of pictures.

        Parameters
        ----------
        record : GopRecord
            The next one in order of display; the first adds one frame, the first key frame.

        Raises
        ------
        ValueError
            If the stream is closed, the number of frames does not fit the configuration, or a digest is
            missing or too many.
        BitstreamError
            If the record would be too large, or the stream too long.
        """
        if self._closed:
            raise ValueError("the stream is closed")
        limit = self.config.gop.length if self._entries else 1
        if record.num_frames > limit:
            raise ValueError(f"`record` must add {limit} frames or fewer, got {record.num_frames}")
        has_digest = self.form is Form.PUNCTURED and bool(record.wyner_ziv)
        if (record.digest is not None) != has_digest:
            raise ValueError("`record` must have a digest in punctured streams if it has Wyner-Ziv frames")
        if len(self._entries) == MAX_GOPS:
            raise BitstreamError(f"a stream has at most {MAX_GOPS} groups of pictures")
        payload = encode_gop(record)
        if len(payload) > MAX_RECORD_BYTES:
            raise BitstreamError(
                f"group of pictures {len(self._entries)} takes {len(payload)} bytes, "
                f"at most {MAX_RECORD_BYTES} fit; use a shorter GOP or smaller frames"
            )
        framed = frame_record(RecordType.GOP, payload)
        self._entries.append(IndexEntry(self.num_bytes, len(framed), record.num_frames))
        self._write(framed)
        self.num_frames += record.num_frames

    def close(self) -> None:
        """Write the end record; the file stays open. Does nothing the second time."""
        if self._closed:
            return
        self._closed = True
        index = StreamIndex(self.num_frames, tuple(self._entries))
        self._write(frame_record(RecordType.END, encode_end(index, self.form)))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
