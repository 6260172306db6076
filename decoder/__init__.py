"""Receiver side: side information, parity requests, reconstruction; `decode` is all of it."""

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from decoder.report import DecodedPicture
    from dvc.video import VideoReader


def decode(
    file: str | os.PathLike[str], jobs: int = 1, reference: "VideoReader | None" = None
) -> "Iterator[DecodedPicture]":
    """Decode a stream picture by picture, as ``dvc-decode`` does.

    Parameters
    ----------
    file : path
        A stream, or any segment of a recording.
    jobs : int, optional
        Processes that decode groups at the same time; the pictures are the same for any number.
    reference : VideoReader, optional
        The original, as `dvc.video.open_video` opens it: what reports compare with, and decoding never sees.

    Yields
    ------
    DecodedPicture
        In order of display.

    Raises
    ------
    BitstreamError
        If the stream is damaged, after all groups of pictures before.
    """
    from decoder.report import DecodeReport
    from decoder.session import decode_stream
    from dvc.stream import open_stream

    with open_stream(os.fspath(file)) as reader:
        report = DecodeReport(reader.config, reference, kept=False)
        for group in decode_stream(reader.config, reader, jobs):
            yield from report.add(group)
