"""Good streams, and the messages of a live run."""

import io
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmarks.hostile.workers import STREAMS
from benchmarks.loopback import accepted, accepting
from dvc.config import (
    CascadeConfig,
    CodecConfig,
    CoderConfig,
    DiscoverMatrix,
    GopConfig,
    Live,
    Qp,
    Quality,
    TurboConfig,
    VideoConfig,
    codec_config,
)
from dvc.feedback import Connection, Dialler
from dvc.stream import GopRecord, StreamReader, StreamWriter
from dvc.video import Frame
from encoder.acceptor import AcceptedPeer

if TYPE_CHECKING:
    from encoder.encoder_session import EncoderSession

PATIENCE_S, COMPILING_S = 0.75, 300.0
"""Patience with a silent peer: in attempts, and in the first run, which may compile kernels."""
Luma = NDArray[np.uint8]
Change = Callable[[bytes], bytes]


def _same(data: bytes) -> bytes:
    return data


@dataclass(frozen=True)
class Material:
    """A short sequence and its streams."""

    frames: list[Frame]  # the sequence
    config: CodecConfig  # configuration of the encoder
    buffered: bytes  # both forms of the stream
    punctured: bytes
    groups: list[list[Luma]]  # luma of the decoded frames of each group of pictures


@cache
def material(codec: str = "2d", by_qp: bool = False) -> Material:
    """Make the material; this also loads all compiled kernels."""
    from encoder.encoder_session import EncoderSession

    height, width, low = (24, 32, 40) if codec == "2d" else (48, 64, 0)
    noise = np.random.default_rng(1).integers(low, 256 - low, (9, height + 32, width + 32))
    texture = np.mean([np.roll(plane, (i // 3, i % 3), (0, 1)) for i, plane in enumerate(noise)], axis=0)
    frames = [
        Frame(texture[t : t + height, t : t + width].astype(np.uint8))
        for t in range(_num_frames(codec, by_qp))
    ]
    config = _config(codec, VideoConfig(width, height, 25, 1, luma_only=True), by_qp)
    file, punctured = io.BytesIO(), io.BytesIO()
    EncoderSession(config).write(frames, file, lambda _: None)
    groups = []
    with StreamReader(io.BytesIO(file.getvalue())) as reader:
        writer = StreamWriter(punctured, reader.config, "punctured")
        for group, record in decoded_groups(reader):
            groups.append(group)
            writer.write_gop(record)
        writer.close()
    return Material(frames, config, file.getvalue(), punctured.getvalue(), groups)


def _num_frames(codec: str, by_qp: bool) -> int:
    """Return frames of two groups of pictures, or of three if the last key frame begins another chain."""
    return 3 if codec == "2d" else 7 if by_qp else 4


def _config(codec: str, video: VideoConfig, by_qp: bool) -> CodecConfig:
    """Return a configuration of short groups of pictures."""
    if codec == "2d":
        quality: Quality = Qp(28) if by_qp else DiscoverMatrix(2)
        coder: CoderConfig = CascadeConfig() if by_qp else TurboConfig()
        return codec_config(video, codec, quality, key={"qp": 36}, coder=coder)
    key = {"qp": 36, "intra_period": 4 if by_qp else 0}
    return codec_config(video, codec, Qp(34) if by_qp else DiscoverMatrix(1), gop=GopConfig(3), key=key)


@cache
def frozen(name: str) -> tuple[bytes, list[list[Luma]]]:
    """Return a frozen stream, and luma of its groups of pictures."""
    stream = (STREAMS / f"{name}.dvc").read_bytes()
    with StreamReader(io.BytesIO(stream)) as reader:
        return stream, [group for group, _ in decoded_groups(reader)]


@cache
def to_encoder(codec: str) -> list[bytes]:
    """Return the bytes that the encoder of a live run receives, one entry for each time."""
    made, received = material(codec), list[bytes]()

    def _keep(data: bytes) -> bytes:
        if data:
            received.append(data)
        return data

    failure, _ = live_run(made, (_same, _keep), COMPILING_S)
    assert failure is None
    return received


def decoded_groups(reader: StreamReader, jobs: int = 1) -> Iterator[tuple[list[Luma], GopRecord]]:
    """Decode a stream: luma of the frames of each group, and its punctured record."""
    from decoder.session import decode_stream

    for group in decode_stream(reader.config, reader, jobs):
        yield [frame.luma for frame in group.frames], group.record


def live_run(
    made: Material,
    change: tuple[Change, Change] = (_same, _same),
    patience_s: float = PATIENCE_S,
) -> list[Exception | None]:
    """Run decoder and encoder in two threads, with changes of received bytes; return their errors."""
    ended: list[Exception | None] = [None, None]

    def _changed(connection: Connection, number: int) -> None:
        receive = connection.receive
        connection.receive = lambda within_s=None: change[number](receive(within_s))  # type: ignore[method-assign]

    def _encode() -> None:
        try:
            peer = accepted(acceptor)
            _changed(peer.connection, 1)
            serve(made, peer)
        except Exception as err:
            ended[1] = err

    def _decode() -> None:
        from decoder.live import LiveSource
        from decoder.session import decode_live

        try:
            with closing(LiveSource(Dialler(listener.host, listener.port, timeout_s=patience_s))) as source:
                _changed(source.connection, 0)
                for _ in decode_live(source.config, source):
                    pass
        except Exception as err:
            ended[0] = err

    with accepting(session(made).config, patience_s) as (listener, acceptor):
        serving = threading.Thread(target=_encode)
        serving.start()
        _decode()
        serving.join()
    return ended


def session(made: Material) -> "EncoderSession":
    """Return an encoder."""
    from encoder.encoder_session import EncoderSession

    return EncoderSession(made.config, Live())


def serve(made: Material, peer: AcceptedPeer) -> None:
    """Run the encoder on a connection."""
    from encoder import live_encoder as live

    live.serve(session(made), made.frames, None, peer, lambda _: None)
