"""Streams in memory, written and decoded."""

import io
from collections.abc import Sequence

from decoder.group_tasks import DecodedGroup
from decoder.session import decode_stream
from dvc.config import CodecConfig
from dvc.stream import Form, GopRecord, StreamReader, StreamWriter


def written(config: CodecConfig, records: Sequence[GopRecord], form: Form) -> bytes:
    """Write a stream of records."""
    file = io.BytesIO()
    with StreamWriter(file, config, form) as writer:
        for record in records:
            writer.write_gop(record)
    return file.getvalue()


def decoded(stream: bytes, jobs: int = 1, wanted: range | None = None) -> list[DecodedGroup]:
    """Decode a stream, or the groups that some frames need."""
    reader = StreamReader(io.BytesIO(stream))
    return list(decode_stream(reader.config, reader, jobs, wanted))
