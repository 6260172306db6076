"""The container: header with the codec configuration, groups of pictures, end; `docs/spec/bitstream.md`."""

from dvc.stream.gop import (
    MAX_DEVIATION_TICKS,
    Deviations,
    GopRecord,
    StreamWriter,
    check_times,
    decode_gop,
    encode_gop,
    frame_times_s,
    gop_bits,
    planned_tick,
)
from dvc.stream.reader import RecordingReader, StreamReader, open_stream
from dvc.stream.records import FORMAT_VERSION, MAGIC, Form, RecordType, StreamIndex

__all__ = [
    "FORMAT_VERSION",
    "MAGIC",
    "MAX_DEVIATION_TICKS",
    "Deviations",
    "Form",
    "GopRecord",
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
