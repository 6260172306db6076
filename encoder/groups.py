"""Groups of pictures: which frames are key frames, and which Wyner-Ziv frames lie between them."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from dvc.video import Frame


@dataclass(frozen=True)
class Group:
    """One group of pictures.

    Attributes
    ----------
    wyner_ziv : tuple of Frame
        Frames since the previous key frame, in display order.
    key : Frame
        The key frame that ends the group.
    """

    wyner_ziv: tuple[Frame, ...]
    key: Frame


def groups(frames: Iterable[Frame], length: int) -> Iterator[Group]:
    """Cut a sequence into groups at a fixed distance of key frames; the last frame is always a key frame.

    Parameters
    ----------
    frames : iterable of Frame
        The sequence; at most `length` of its frames are held at a time.
    length : int
        Frames from one key frame to the next, at least 1.

    Yields
    ------
    Group
        The first holds the first frame alone.
    """
    waiting: list[Frame] = []
    for index, frame in enumerate(frames):
        if index % length == 0:
            yield Group(tuple(waiting), frame)
            waiting = []
        else:
            waiting.append(frame)
    if waiting:
        yield Group(tuple(waiting[:-1]), waiting[-1])
