"""The container: header with the codec configuration, groups of pictures, end; see `docs/bitstream.md`."""

from dvc.stream.deviations import (
    MAX_DEVIATION_TICKS,
    Deviations,
    check_times,
    frame_times_s,
    planned_tick,
)
from dvc.stream.gop import GopBits, GopRecord, decode_gop, encode_gop, gop_bits
from dvc.stream.index import IndexEntry, StreamIndex
from dvc.stream.reader import StreamReader
from dvc.stream.recording import RecordingReader, open_stream
from dvc.stream.records import FORMAT_VERSION, MAGIC, MAX_RECORD_BYTES, Form, RecordType
from dvc.stream.writer import StreamWriter

__all__ = [
    "FORMAT_VERSION",
    "MAGIC",
    "MAX_DEVIATION_TICKS",
    "MAX_RECORD_BYTES",
    "Deviations",
    "Form",
    "GopBits",
    "GopRecord",
    "IndexEntry",
    "RecordType",
    "RecordingReader",
    "StreamIndex",
    "StreamReader",
    "StreamWriter",
    "check_times",
    "decode_gop",
    "encode_gop",
    "frame_times_s",
    "gop_bits",
    "open_stream",
    "planned_tick",
]
