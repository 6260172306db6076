"""The container: header with the codec configuration, groups of pictures, end; see `docs/bitstream.md`."""

from dvc.stream.gop import GopBits, GopRecord, LongTermReference, decode_gop, encode_gop, gop_bits
from dvc.stream.index import IndexEntry, StreamIndex
from dvc.stream.reader import StreamReader
from dvc.stream.recording import RecordingReader, open_stream
from dvc.stream.records import FORMAT_VERSION, MAGIC, MAX_RECORD_BYTES, Form, RecordType
from dvc.stream.writer import StreamWriter

__all__ = [
    "FORMAT_VERSION",
    "MAGIC",
    "MAX_RECORD_BYTES",
    "Form",
    "GopBits",
    "GopRecord",
    "IndexEntry",
    "LongTermReference",
    "RecordType",
    "RecordingReader",
    "StreamIndex",
    "StreamReader",
    "StreamWriter",
    "decode_gop",
    "encode_gop",
    "gop_bits",
    "open_stream",
]
