"""Decoded pictures with what is known of each: what was predicted, depth, and what it cost."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decoder.report import DecodeReport
from decoder.session import decode_stream
from decoder.tasks import DecodedGroup
from dvc.config import VideoConfig
from dvc.stream import open_stream
from dvc.video import Frame, VideoReader

Predicted = NDArray[np.uint8] | None
InverseDepth = NDArray[np.float16] | None


@dataclass(frozen=True, eq=False)
class DecodedPicture:
    """A decoded frame, and what it was made from.

    Attributes
    ----------
    time_s : Fraction
        When it is shown, in seconds.
    frame : Frame
        The frame.
    predicted : ndarray of shape (H, W), uint8, or None
        Luma as it was predicted before anything of the frame was decoded; None for a key frame.
    inverse_depth : ndarray of shape (H, W), float16, or None
        Depth that it was predicted by, in the unit of a model of its group; None without a dense one.
    report : dict
        What ``dvc-decode --json`` tells of the frame: ``index``, ``type``, ``bits`` by kind, and more.
    """

    time_s: Fraction
    frame: Frame
    predicted: Predicted
    inverse_depth: InverseDepth
    report: dict[str, Any]


def pictures_of(group: DecodedGroup, video: VideoConfig, rows: list[dict[str, Any]]) -> list[DecodedPicture]:
    """Return the pictures of a group, with the rows of a report for them."""
    made_from: list[tuple[Predicted, InverseDepth]] = []
    made_from += [(frame.side_information, frame.inverse_depth) for frame in group.wyner_ziv]
    made_from += [(None, None)] * (len(rows) - len(made_from))  # of its key frame
    shown = zip(group.times_s(video), group.frames, made_from, rows, strict=True)
    return [DecodedPicture(time_s, frame, *made, row) for time_s, frame, made, row in shown]


def decoded_pictures(
    file: str | os.PathLike[str], jobs: int, reference: VideoReader | None
) -> Iterator[DecodedPicture]:
    """Decode a stream; see `decoder.decode`."""
    with open_stream(os.fspath(file)) as reader:
        config = reader.config
        report = DecodeReport(config, reference)
        for group in decode_stream(config, reader, jobs):
            yield from pictures_of(group, config.video, report.add(group))
