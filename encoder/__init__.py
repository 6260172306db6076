"""Camera side: key frames, parity of the Wyner-Ziv frames, answers to requests; `encode` is all of it."""

import os
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dvc.config import CodecConfig, Delivery
    from dvc.video import Frame
    from encoder.encoder_report import EncoderStatistics


def encode(
    frames: "Iterable[Frame]",
    config: "CodecConfig",
    file: str | os.PathLike[str],
    delivery: "Delivery | None" = None,
) -> "EncoderStatistics":
    """Encode frames into a stream, as ``dvc-encode`` does.

    Parameters
    ----------
    frames : iterable of Frame
        Frames of the size in the configuration; read once, a group of pictures at a time.
    config : CodecConfig
        Configuration from `dvc.config.codec_config`.
    file : path
        Stream to write, complete or not at all.
    delivery : ParityBuffer or NoFeedback, optional
        All planes of Wyner-Ziv frames, by default, or none.

    Returns
    -------
    EncoderStatistics
        Frames, bits and times.

    Raises
    ------
    VideoError
        If the sequence is empty, or a frame has another size.
    """
    from dvc.errors import VideoError
    from dvc.files import SyncedFile, atomic_output
    from encoder.encoder_session import EncoderSession

    width, height = config.video.width, config.video.height

    def checked() -> "Iterator[Frame]":
        for frame in frames:
            if (frame.width, frame.height) != (width, height):
                raise VideoError(f"a frame has {frame.width}x{frame.height} pixels, not {width}x{height}")
            yield frame

    session = EncoderSession(config, delivery)
    with atomic_output(os.fspath(file)) as temporary, SyncedFile(temporary) as stream:
        session.write(checked(), stream, lambda _: None)
        if session.statistics.num_frames == 0:
            raise VideoError("the sequence has no frames")
    return session.statistics
