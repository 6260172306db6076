"""From the frames of a whole sequence to the map of its scene: the steps, in order."""

from collections.abc import Callable, Iterable, Iterator

from dvc.config import MAPPERS
from dvc.video import Frame, open_video
from sfm.mapping.colmap_mapper import colmap_pieces
from sfm.mapping.dense import dense_pieces
from sfm.mapping.incremental_mapper import reconstruct_pieces
from sfm.mapping.point_tracker import track_sequence
from sfm.mapping.scene_map import SceneMap

FrameSource = Callable[[], Iterable[Frame]]
"""Gives all frames from the first to the last, whenever it is called: they are read again, not kept."""


def map_sequence(
    frames: FrameSource,
    *,
    mapper: str = "native",
    report: Callable[[str], None] | None = None,
) -> SceneMap:
    """Find the cameras of a sequence, the depth of its key frames and one cloud of points.

    Parameters
    ----------
    frames : callable
        Returns the frames of the sequence from the first to the last; called once for every pass.
    mapper : str
        ``"native"`` or ``"colmap"``.
    report : callable, optional
        Called with one line of text before each step.

    Returns
    -------
    SceneMap
        Without pieces where the frames show no scene that can be reconstructed; never an exception for what
        they show.

    Raises
    ------
    ValueError
        If there is no such mapper, or the frames differ in size.
    """
    if mapper not in MAPPERS:
        raise ValueError(f"`mapper` must be one of {', '.join(MAPPERS)}, got {mapper!r}")
    tell = report or (lambda _: None)
    tell("tracking points")
    seen = track_sequence(frames())
    native = mapper == "native"
    structures = reconstruct_pieces(seen, tell) if native else colmap_pieces(frames, seen, tell)
    pieces = dense_pieces(frames(), seen, structures, tell)
    return SceneMap(seen.width_px, seen.height_px, len(seen.seen), pieces)


def map_video(path: str, *, mapper: str = "native", report: Callable[[str], None] | None = None) -> SceneMap:
    """Map a video file or a folder of pictures, which is read several times.

    Parameters
    ----------
    path : str
        Anything that `dvc.video.open_video` reads more than once.
    mapper : str
        ``"native"`` or ``"colmap"``.
    report : callable, optional
        Called with one line of text before each step.

    Returns
    -------
    SceneMap
        See `map_sequence`.

    Raises
    ------
    DvcError
        If the video cannot be read.
    """

    def frames() -> Iterator[Frame]:
        with open_video(path) as video:
            yield from video

    return map_sequence(frames, mapper=mapper, report=report)
