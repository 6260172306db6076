"""The container: header with the codec configuration, groups of pictures, end; `docs/spec/bitstream.md`."""

from dvc.stream.gop import (
    MAX_DEVIATION_TICKS as MAX_DEVIATION_TICKS,
    Deviations as Deviations,
    GopRecord as GopRecord,
    StreamWriter as StreamWriter,
    check_times as check_times,
    decode_gop as decode_gop,
    encode_gop as encode_gop,
    frame_times_s as frame_times_s,
    gop_bits as gop_bits,
    planned_tick as planned_tick,
)
from dvc.stream.reader import (
    RecordingReader as RecordingReader,
    StreamReader as StreamReader,
    open_stream as open_stream,
)
from dvc.stream.records import (
    FORMAT_VERSION as FORMAT_VERSION,
    MAGIC as MAGIC,
    Form as Form,
    RecordType as RecordType,
    StreamIndex as StreamIndex,
)
