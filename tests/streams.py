"""Streams in memory, written and decoded."""

import io
from collections.abc import Iterable, Sequence

from decoder.group_tasks import DecodedGroup, GroupTask
from decoder.session import decode_stream, stream_tasks
from dvc.config import CodecConfig
from dvc.stream import Form, GopRecord, StreamReader, StreamWriter
from dvc.video import Frame
from encoder.encoder_session import EncoderSession


def written(config: CodecConfig, records: Sequence[GopRecord], form: Form) -> bytes:
    """Write a stream of records."""
    file = io.BytesIO()
    with StreamWriter(file, config, form) as writer:
        for record in records:
            writer.write_gop(record)
    return file.getvalue()


def encoded(config: CodecConfig, frames: Iterable[Frame]) -> bytes:
    """Encode frames into a buffered stream."""
    file = io.BytesIO()
    EncoderSession(config).write(frames, file, lambda _: None)
    return file.getvalue()


def config_of(stream: bytes) -> CodecConfig:
    """Return the configuration of a stream."""
    return StreamReader(io.BytesIO(stream)).config


def tasks_of(stream: bytes, frames: range | None = None) -> list[GroupTask]:
    """Return the groups of a stream, or those that some frames need."""
    reader = StreamReader(io.BytesIO(stream))
    return list(stream_tasks(reader.config, reader, frames))


def decoded(stream: bytes, jobs: int = 1, wanted: range | None = None) -> list[DecodedGroup]:
    """Decode a stream, or the groups that some frames need."""
    reader = StreamReader(io.BytesIO(stream))
    return list(decode_stream(reader.config, reader, jobs, wanted))
