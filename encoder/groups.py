"""Groups of pictures at a fixed distance of key frames, with or without the corners of their frames."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

from dvc.config import CodecConfig
from dvc.tracks import FeaturePoints, PointTracks, encode_points
from dvc.video import Frame
from encoder.corner_detector import CornerDetector
from encoder.work import TrackingWork


@dataclass(frozen=True)
class Group:
    """One group of pictures."""

    wyner_ziv: tuple[Frame, ...]  # frames since the previous key frame, in display order
    key: Frame  # the key frame that ends the group
    # points of the previous key frame tracked to this one, and points of this one tracked back
    tracks: PointTracks | None = None
    points: FeaturePoints | None = None  # corners of the Wyner-Ziv frames
    begins_scene: bool = False  # whether the key frame is the first one after a cut


class GroupCoder(Protocol):
    """Divides a sequence into groups of pictures, and codes their points."""

    def groups(self, frames: Iterable[Frame]) -> Iterator[Group]:
        """Yield the groups of a sequence; its last frame is always a key frame."""

    def payload(self, group: Group) -> bytes:
        """Return the coded points of a group with Wyner-Ziv frames."""


class FixedGroups:
    """Groups at a fixed distance of key frames, without points."""

    def __init__(self, length: int) -> None:
        self._length = length

    def groups(self, frames: Iterable[Frame]) -> Iterator[Group]:
        """Yield the groups of a sequence."""
        waiting: list[Frame] = []
        for index, frame in enumerate(frames):
            if index % self._length == 0:
                yield Group(tuple(waiting), frame)
                waiting = []
            else:
                waiting.append(frame)
        if waiting:
            yield Group(tuple(waiting[:-1]), waiting[-1])

    def payload(self, group: Group) -> bytes:
        """Return nothing: the groups have no points."""
        del group
        return b""


class CornerGroups(FixedGroups):
    """Groups at a fixed distance of key frames, with the corners of their Wyner-Ziv frames."""

    def __init__(self, config: CodecConfig, work: TrackingWork) -> None:
        super().__init__(config.gop.length)
        self._config, self._detector = config, CornerDetector(config.tracks.num_points, work=work)

    def groups(self, frames: Iterable[Frame]) -> Iterator[Group]:
        """Yield the groups of a sequence."""
        for group in super().groups(frames):
            yield replace(group, points=self._detector.detect([frame.luma for frame in group.wyner_ziv]))

    def payload(self, group: Group) -> bytes:
        """Return the coded corners."""
        assert group.points is not None
        return encode_points(group.points, self._config)
