"""From the frames of a whole sequence to the map of its scene: the steps, in order."""

from collections.abc import Callable, Iterable, Iterator

from dvc.config import MAPPERS
from dvc.video import Frame, open_video
from sfm.mapping.colmap_mapper import map_pieces_by_colmap
from sfm.mapping.dense import dense_pieces
from sfm.mapping.incremental_mapper import map_pieces
from sfm.mapping.scene_map import SceneMap
from sfm.mapping.sequence_tracks import track_sequence

FrameSource = Callable[[], Iterable[Frame]]
"""Function that reads all frames from the first to the last; it is called once for every pass."""


def map_sequence(
    frames: FrameSource,
    *,
    mapper: str = "native",
    report: Callable[[str], None] | None = None,
) -> SceneMap:
    """Map a sequence: its cameras, the depth of its key frames and one cloud of points.

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
        Without pieces if the frames show no scene that can be reconstructed; their content never raises.

    Raises
    ------
    ValueError
        If the mapper is unknown, or the frames differ in size.
    """
    if mapper not in MAPPERS:
        raise ValueError(f"`mapper` must be one of {', '.join(MAPPERS)}, got {mapper!r}")
    log = report or (lambda _: None)
    log("tracking points")
    tracks = track_sequence(frames())
    is_native = mapper == "native"
    structures = map_pieces(tracks, log) if is_native else map_pieces_by_colmap(frames, tracks, log)
    pieces = dense_pieces(frames(), tracks, structures, log)
    return SceneMap(tracks.width_px, tracks.height_px, len(tracks.seen), pieces)


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
