"""What hostile input is made of: good streams, and the messages of a live run."""

import io
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

<<<<<<< HEAD
from dvc.config import CodecConfig, DiscoverMatrix, GopConfig, Live, Qp, Quality, VideoConfig, codec_config
=======
from dvc.config import (
    ALLOCATED_FAMILY,
    Allocation,
    CodecConfig,
    GopConfig,
    KeyFrameConfig,
    TurboConfig,
    VideoConfig,
    WynerZivConfig,
    allocation,
)
>>>>>>> 5c8c9ae (benchmarks: hostile campaign: more kinds, several mutations at a time, limits by size)
from dvc.feedback import Connection, connect, listen
from dvc.stream import Form, GopRecord, StreamReader, StreamWriter
from dvc.video import Frame

PATIENCE_S, COMPILING_S = 2.0, 120.0
"""How long a silent peer is waited for: in attempts, and in the first run, which may compile kernels."""
STREAMS = Path(__file__).resolve().parents[2] / "tests" / "golden" / "streams"
Luma = NDArray[np.uint8]
Change = Callable[[bytes], bytes]


def _same(data: bytes) -> bytes:
    return data


@dataclass(frozen=True)
class Material:
    """A short sequence and what is made of it."""

    frames: list[Frame]  # the sequence
    config: CodecConfig  # configuration of the encoder
    shared: Allocation | None  # quality of `--qp`
    buffered: bytes  # both forms of the stream
    punctured: bytes
    groups: list[list[Luma]]  # luma of the decoded frames of each group of pictures


@cache
def material(codec: str = "2d", allocated: bool = False) -> Material:
    """Make the material; this also loads all compiled kernels."""
    from encoder.session import EncoderSession

    height, width, low = (24, 32, 40) if codec == "2d" else (48, 64, 0)
    noise = np.random.default_rng(1).integers(low, 256 - low, (9, height + 32, width + 32))
    texture = np.mean([np.roll(plane, (i // 3, i % 3), (0, 1)) for i, plane in enumerate(noise)], axis=0)
<<<<<<< HEAD
    frames = [Frame(texture[t : t + 24, t : t + 32].astype(np.uint8)) for t in range(7)]
    video = VideoConfig(32, 24, 25, 1, luma_only=True)
    quality: Quality = Qp(28) if allocated else DiscoverMatrix(2)
    coder = {} if allocated else {"family": "classical"}
    config = codec_config(video, "2d", quality, key={"qp": 36}, turbo=coder)
    file = io.BytesIO()
    EncoderSession(config).write(frames, file, lambda _: None)
    groups, punctured = [], io.BytesIO()
=======
    frames = [Frame(texture[t : t + height, t : t + width].astype(np.uint8)) for t in range(7)]
    shared = allocation(28 if codec == "2d" else 34) if allocated else None
    config = _config(codec, VideoConfig(width, height, 25, 1, luma_only=True), shared)
    file, punctured = io.BytesIO(), io.BytesIO()
    EncoderSession(config, allocation=shared).write(frames, file, lambda _: None)
    groups = []
>>>>>>> 5c8c9ae (benchmarks: hostile campaign: more kinds, several mutations at a time, limits by size)
    with StreamReader(io.BytesIO(file.getvalue())) as reader:
        writer = StreamWriter(punctured, reader.config, Form.PUNCTURED)
        for group, record in decoded_groups(reader):
            groups.append(group)
            writer.write_gop(record)
        writer.close()
    return Material(frames, config, shared, file.getvalue(), punctured.getvalue(), groups)


def _config(codec: str, video: VideoConfig, shared: Allocation | None) -> CodecConfig:
    gop = GopConfig(2) if codec == "2d" else GopConfig(3, "hierarchical")
    quantised = WynerZivConfig.preset(2 if codec == "2d" else 1) if shared is None else shared.wyner_ziv
    config = CodecConfig.preset(codec, video, gop=gop, key=KeyFrameConfig(36), wyner_ziv=quantised)
    if shared is not None:
        config = replace(config, turbo=TurboConfig(ALLOCATED_FAMILY))
        if codec != "2d":
            fallback = replace(config.side_information, fallback="tracks")
            gop = replace(gop, anchor_distance=2, intra_period=6)
            config = replace(config, gop=gop, side_information=fallback)
    return config


@cache
<<<<<<< HEAD
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
=======
def frozen(name: str) -> tuple[bytes, list[list[Luma]]]:
    """Return a frozen stream, and luma of its groups of pictures."""
    stream = (STREAMS / f"{name}.dvc").read_bytes()
    with StreamReader(io.BytesIO(stream)) as reader:
        return stream, [group for group, _ in decoded_groups(reader)]
>>>>>>> 5c8c9ae (benchmarks: hostile campaign: more kinds, several mutations at a time, limits by size)


@cache
def to_encoder(codec: str) -> list[bytes]:
    """Return the bytes that the encoder of a live run receives, one entry for each time."""
    made, received = material(codec), list[bytes]()

    def _keep(data: bytes) -> bytes:
        received.append(data)
        return data

    failure, _ = live_run(made, (_same, _keep), COMPILING_S)
    assert failure is None
    return received


def decoded_groups(reader: StreamReader, jobs: int = 1) -> Iterator[tuple[list[Luma], GopRecord]]:
    """Decode a stream: luma of the frames of each group, and its record with what was needed of it."""
    from decoder.session import decode_stream

    for group in decode_stream(reader.config, reader, jobs):
        yield [frame.luma for frame in group.frames], group.record


def live_run(
    made: Material,
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
    serving = threading.Thread(target=_run, args=(1, far, partial(serve, made)))
    serving.start()
    _run(0, near, decode_live)
    serving.join()
    return ended


def serve(made: Material, connection: Any) -> None:
    """Run the encoder on a connection."""
    from encoder import live
    from encoder.session import EncoderSession

<<<<<<< HEAD
    live.serve(EncoderSession(config, Live()), frames, connection, lambda _: None)
=======
    live.serve(EncoderSession(made.config), made.frames, connection, lambda _: None)
>>>>>>> 5c8c9ae (benchmarks: hostile campaign: more kinds, several mutations at a time, limits by size)


def decode_live(connection: Any) -> None:
    """Run the decoder on a connection."""
    from decoder.live import LiveSource
    from decoder.session import decode_live

    source = LiveSource(connection)
    for _ in decode_live(source.config, source):
        pass
