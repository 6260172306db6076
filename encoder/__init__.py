"""Camera side: key frames, parity of the Wyner-Ziv frames, answers to requests; `encode` is all of it."""

import os
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dvc.config import CodecConfig, Delivery
    from dvc.video import Frame
    from encoder.report import EncoderStatistics


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
        Of the size that the configuration tells; read once, a group of pictures at a time.
    config : CodecConfig
        As `dvc.config.codec_config` makes it.
    file : path
        Where the stream goes; there is nothing until it is whole.
    delivery : ParityBuffer or NoFeedback, optional
        All planes of Wyner-Ziv frames, of which a decoder takes what it needs, by default; or nothing.

    Returns
    -------
    EncoderStatistics
        Frames, bits and times.

    Raises
    ------
    VideoError
        If there are no frames, or one has another size.
    """
    from dvc.errors import VideoError
    from dvc.files import SyncedFile, atomic_output
    from encoder.session import EncoderSession

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
            raise VideoError("there are no frames")
    return session.statistics
