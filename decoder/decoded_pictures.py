"""Decoded pictures with their predictions, depths and costs."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from decoder.group_tasks import DecodedGroup
from decoder.report import DecodeReport
from decoder.session import decode_stream
from dvc.config import VideoConfig
from dvc.stream import open_stream
from dvc.video import Frame, VideoReader


class PredictionData(NamedTuple):
    """Data that predicted a frame, if any did."""

    predicted: NDArray[np.uint8] | None = None
    inverse_depth: NDArray[np.float16] | None = None
    camera: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class DecodedPicture:
    """A decoded frame, and the data that it was made from.

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
    camera : ndarray of shape (3, 4), float64, or None
        Of the frame, in normalised coordinates and the basis of its group's model.
    report : dict
        Row of the frame in ``dvc-decode --json``: ``index``, ``type``, ``bits`` by kind, and more.
    """

    time_s: Fraction
    frame: Frame
    predicted: NDArray[np.uint8] | None
    inverse_depth: NDArray[np.float16] | None
    camera: NDArray[np.float64] | None
    report: dict[str, Any]


def pictures_of(
    group: DecodedGroup, video: VideoConfig, rows: Sequence[dict[str, Any]]
) -> Iterator[DecodedPicture]:
    """Yield those pictures of a group that a report has rows of."""
    made_from: dict[int, PredictionData] = {
        frame.index: PredictionData(frame.side_information, frame.inverse_depth, frame.camera)
        for frame in group.wyner_ziv
    }
    times_s, frames = group.times_s(video), group.frames
    for row in rows:
        number = row["index"] - group.first_index
        yield DecodedPicture(
            times_s[number], frames[number], *made_from.get(row["index"], PredictionData()), row
        )


def decoded_pictures(
    file: str | os.PathLike[str], jobs: int, reference: VideoReader | None
) -> Iterator[DecodedPicture]:
    """Decode a stream; see `decoder.decode`."""
    with open_stream(os.fspath(file)) as reader:
        config = reader.config
        report = DecodeReport(config, reference, kept=False)
        for group in decode_stream(config, reader, jobs):
            yield from pictures_of(group, config.video, report.add(group))
