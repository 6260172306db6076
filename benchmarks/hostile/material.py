"""What hostile input is made of: good streams, and the messages of a live run."""

import io
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.config import CodecConfig, DiscoverMatrix, GopConfig, Live, Qp, Quality, VideoConfig, codec_config
from dvc.feedback import Connection, connect, listen
from dvc.stream import GopRecord, StreamReader, StreamWriter
from dvc.video import Frame

PATIENCE_S, COMPILING_S = 2.0, 120.0
"""How long a silent peer is waited for: in attempts, and in the first run, which may compile kernels."""
Luma = NDArray[np.uint8]
Change = Callable[[bytes], bytes]


def _same(data: bytes) -> bytes:
    return data


@dataclass(frozen=True)
class Material:
    """A short sequence and everything that is made of it."""

    frames: list[Frame]  # the sequence
    config: CodecConfig  # configuration of the encoder
    buffered: bytes  # both forms of the stream
    punctured: bytes
    groups: list[list[Luma]]  # luma of the decoded frames of each group of pictures
    to_encoder: list[bytes]  # bytes that the encoder of a live run received, one entry for each time


@cache
def material(allocated: bool = False) -> Material:
    """Make the material; this also loads all compiled kernels."""
    from encoder.session import EncoderSession

    noise = np.random.default_rng(1).integers(40, 216, (9, 40, 56))
    texture = np.mean([np.roll(plane, (i // 3, i % 3), (0, 1)) for i, plane in enumerate(noise)], axis=0)
    frames = [Frame(texture[t : t + 24, t : t + 32].astype(np.uint8)) for t in range(7)]
    video = VideoConfig(32, 24, 25, 1, luma_only=True)
    quality: Quality = Qp(28) if allocated else DiscoverMatrix(2)
    coder = {} if allocated else {"family": "classical"}
    config = codec_config(video, "2d", quality, key={"qp": 36}, turbo=coder)
    file = io.BytesIO()
    EncoderSession(config).write(frames, file, lambda _: None)
    groups, punctured = [], io.BytesIO()
    with StreamReader(io.BytesIO(file.getvalue())) as reader:
        writer = StreamWriter(punctured, reader.config, "punctured")
        for group, record in decoded_groups(reader):
            groups.append(group)
            writer.write_gop(record)
        writer.close()
    to_encoder = [] if allocated else _record_live(frames, config)
    return Material(frames, config, file.getvalue(), punctured.getvalue(), groups, to_encoder)


@cache
def tracked_material(codec: str, allocated: bool = False) -> tuple[bytes, list[list[Luma]]]:
    """Make a stream whose groups of pictures carry tracks or points."""
    from encoder.session import EncoderSession

    noise = np.random.default_rng(1).integers(0, 256, (9, 80, 96))
    texture = np.mean([np.roll(plane, (i // 3, i % 3), (0, 1)) for i, plane in enumerate(noise)], axis=0)
    frames = [Frame(texture[t : t + 48, t : t + 64].astype(np.uint8)) for t in range(7)]
    video, gop = VideoConfig(64, 48, 25, 1, luma_only=True), GopConfig(3, "hierarchical", 0, 0)
    config = codec_config(video, codec, DiscoverMatrix(1), gop=gop, key={"qp": 36})
    if allocated:
        gop = replace(gop, p_type_distance=2, intra_period=6)
        config = codec_config(video, codec, Qp(34), gop=gop, key={"qp": 36})
    file = io.BytesIO()
    EncoderSession(config).write(frames, file, lambda _: None)
    with StreamReader(io.BytesIO(file.getvalue())) as reader:
        return file.getvalue(), [group for group, _ in decoded_groups(reader)]


def decoded_groups(reader: StreamReader) -> Iterator[tuple[list[Luma], GopRecord]]:
    """Decode a stream: luma of the frames of each group, and its record with what was needed of it."""
    from decoder.session import decode_stream

    for group in decode_stream(reader.config, reader):
        yield [frame.luma for frame in group.frames], group.record


def live_run(
    frames: list[Frame],
    config: CodecConfig,
    change: tuple[Change, Change] = (_same, _same),
    patience_s: float = PATIENCE_S,
) -> list[Exception | None]:
    """Run encoder and decoder on a connection between two threads."""
    ended: list[Exception | None] = [None, None]

    def _run(number: int, end: Connection, work: Callable[[Connection], None]) -> None:
        receive = end.receive
        end.receive = lambda: change[number](receive())  # type: ignore[method-assign]
        with end:
            try:
                work(end)
            except Exception as err:
                ended[number] = err

    with listen() as listener:
        near = connect(listener.host, listener.port, patience_s)
        far = listener.accept(patience_s, patience_s)
    serving = threading.Thread(target=_run, args=(1, far, partial(serve, frames, config)))
    serving.start()
    _run(0, near, decode_live)
    serving.join()
    return ended


def _record_live(frames: list[Frame], config: CodecConfig) -> list[bytes]:
    received: list[bytes] = []

    def _keep(data: bytes) -> bytes:
        received.append(data)
        return data

    failure, _ = live_run(frames, config, (_same, _keep), COMPILING_S)
    assert failure is None
    return received


def serve(frames: list[Frame], config: CodecConfig, connection: Any) -> None:
    """Run the encoder on a connection."""
    from encoder import live
    from encoder.session import EncoderSession

    live.serve(EncoderSession(config, Live()), frames, connection, lambda _: None)


def decode_live(connection: Any) -> None:
    """Run the decoder on a connection."""
    from decoder.live import LiveSource
    from decoder.session import decode_live

    source = LiveSource(connection)
    for _ in decode_live(source.config, source):
        pass
