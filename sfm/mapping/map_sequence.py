"""From the frames of a whole sequence to the map of its scene: the steps, in order, and COLMAP's mapper."""

import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dvc.arrays import Floats
from dvc.config import MAPPERS
from dvc.geometry.camera_estimation import quiet
from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX
from dvc.picture_files import write_png
from dvc.video import Frame, open_video
from sfm.mapping.dense import dense_pieces
from sfm.mapping.incremental_mapper import MIN_KEYS, map_pieces, register_frames
from sfm.mapping.scene_map import SceneMap
from sfm.mapping.sequence_tracks import SequenceTracks, evenly_spaced, track_sequence
from sfm.mapping.structure import SEED, Structure, observations, triangulate

FrameSource = Callable[[], Iterable[Frame]]
"""Function that reads all frames from the first to the last; it is called once for every pass."""
MAX_FRAMES = 120
"""Largest number of frames that COLMAP maps."""
MAX_EXHAUSTIVE = 30
"""Largest number of frames with exhaustive matching; more frames are matched with near ones only."""
OVERLAP = 12
"""Number of following frames that each frame is matched with."""
INITIAL_ANGLES_DEG = (16.0, 4.0, 1.5)
"""Least angles between the rays of the first pair to try: COLMAP's default, then angles for slow cameras."""
ENOUGH_SHARE = 0.9
"""Share of registered frames in one model that ends the attempts."""


def map_sequence(
    frames: FrameSource, *, mapper: str = "native", report: Callable[[str], None] | None = None
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
    structures = map_pieces(tracks, log) if is_native else map_pieces_by_colmap(frames(), tracks, log)
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


def map_pieces_by_colmap(
    frames: Iterable[Frame], tracks: SequenceTracks, report: Callable[[str], None]
) -> list[Structure]:
    """Locate key frames by COLMAP's mapper and other frames by tracks; return them in temporal order."""
    keys = tracks.key_frames
    chosen = evenly_spaced(keys, MAX_FRAMES)
    if len(chosen) < MIN_KEYS:
        return []
    report(f"COLMAP: {len(chosen)} key frames")
    with tempfile.TemporaryDirectory() as folder, quiet():
        models = run_colmap(Path(folder), write_pictures(Path(folder), frames, chosen))
    pieces: list[Structure] = []
    located: set[int] = set()
    for model in sorted(models, key=lambda each: -each.num_reg_images()):
        K = np.array(next(iter(model.cameras.values())).calibration_matrix(), np.float64)
        K[:2, 2] -= COLMAP_FIRST_PIXEL_PX
        poses = {k: pose for k, pose in sorted(model_poses(model).items()) if k not in located}
        piece = Structure(K, poses, np.full((tracks.num_points, 3), np.nan))
        numbers, points = triangulate(piece, observations(tracks.seen, list(poses)))
        piece.points[numbers] = points
        if len(poses) >= MIN_KEYS:
            reach = [k for k in reach_of(keys, min(poses), max(poses)) if k not in located]
            piece = register_frames(piece, tracks, reach)
            located |= piece.poses.keys()
            pieces.append(piece)
    return sorted(pieces, key=lambda each: min(each.poses))


def reach_of(keys: Sequence[int], first: int, last: int) -> range:
    """Return the frames from the key frame before a piece to the key frame after it."""
    before, after = [key for key in keys if key < first], [key for key in keys if key > last]
    return range(before[-1] if before else first, (after[0] if after else last) + 1)


def write_pictures(folder: Path, frames: Iterable[Frame], chosen: Sequence[int]) -> list[str]:
    """Write the luma of some frames; return the names of the files."""
    names = []
    for index, frame in enumerate(frames):
        if index in chosen:
            names.append(f"{index:08d}.png")
            write_png(folder / names[-1], frame.luma)
    return names


def run_colmap(folder: Path, names: Sequence[str], camera_model: str = "SIMPLE_PINHOLE") -> list[Any]:
    """Return COLMAP's models of the pictures of one camera in a folder."""
    import pycolmap

    database = folder / "features.db"
    pycolmap.set_random_seed(SEED)
    pycolmap.extract_features(
        database,
        folder,
        image_names=list(names),
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=pycolmap.ImageReaderOptions(camera_model=camera_model),
        extraction_options=pycolmap.FeatureExtractionOptions(use_gpu=False, num_threads=1),
        device=pycolmap.Device.cpu,
    )
    matching = pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=1)
    if len(names) <= MAX_EXHAUSTIVE:
        pycolmap.match_exhaustive(database, matching_options=matching, device=pycolmap.Device.cpu)
    else:
        pairing = pycolmap.SequentialPairingOptions(overlap=OVERLAP, quadratic_overlap=True)
        pycolmap.match_sequential(
            database, matching_options=matching, pairing_options=pairing, device=pycolmap.Device.cpu
        )
    best: list[Any] = []
    for attempt, angle in enumerate(INITIAL_ANGLES_DEG):
        target = folder / f"model{attempt}"
        target.mkdir()
        pycolmap.set_random_seed(SEED)
        options = pycolmap.IncrementalPipelineOptions(
            num_threads=1, random_seed=SEED, min_model_size=MIN_KEYS, extract_colors=False
        )
        options.mapper.init_min_tri_angle = angle
        options.mapper.filter_min_tri_angle = min(angle, options.mapper.filter_min_tri_angle)
        options.triangulation.min_angle = min(angle, options.triangulation.min_angle)
        models = list(pycolmap.incremental_mapping(database, folder, target, options).values())
        if sum(each.num_reg_images() for each in models) > sum(each.num_reg_images() for each in best):
            best = models
        if max((each.num_reg_images() for each in best), default=0) >= ENOUGH_SHARE * len(names):
            break
    return best


def model_poses(model: Any) -> dict[int, Floats]:
    """Return the poses of a model's pictures, which are named by their frame index."""
    return {
        int(Path(image.name).stem): np.asarray(image.cam_from_world().matrix(), np.float64)
        for image in model.images.values()
        if image.has_pose
    }
