"""Mapping by COLMAP: its incremental mapper on key frames; tracked points locate all other frames."""

import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dvc.arrays import Floats
from dvc.geometry.camera_estimation import quiet
from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX
from dvc.video import Frame
from sfm.mapping.incremental_mapper import MIN_KEYS, register_frames
from sfm.mapping.sequence_tracks import SequenceTracks
from sfm.mapping.structure import SEED, Structure, observations, triangulate

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


def map_pieces_by_colmap(
    frames: Callable[[], Iterable[Frame]], tracks: SequenceTracks, report: Callable[[str], None]
) -> list[Structure]:
    """Reconstruct a sequence as structures that share no coordinate frame, in temporal order."""
    chosen = _spaced(tracks.key_frames)
    if len(chosen) < MIN_KEYS:
        return []
    report(f"COLMAP: {len(chosen)} key frames")
    with tempfile.TemporaryDirectory() as folder, quiet():
        names = _write_pictures(Path(folder), frames(), chosen)
        models = run_colmap(Path(folder), names)
    pieces: list[Structure] = []
    located: set[int] = set()
    for model in sorted(models, key=lambda each: -each.num_reg_images()):
        piece = _structure(model, tracks, located)
        if len(piece.poses) >= MIN_KEYS:
            reach = _reach(tracks.key_frames, min(piece.poses), max(piece.poses))
            piece = register_frames(piece, tracks, [frame for frame in reach if frame not in located])
            located |= piece.poses.keys()
            pieces.append(piece)
    return sorted(pieces, key=lambda each: min(each.poses))


def _spaced(keys: Sequence[int]) -> list[int]:
    """Return evenly spaced key frames, a limited number."""
    chosen = np.unique(np.linspace(0, len(keys) - 1, min(len(keys), MAX_FRAMES)).round().astype(int))
    return [keys[index] for index in chosen] if keys else []


def _reach(keys: Sequence[int], first: int, last: int) -> range:
    """Return the frames from the key frame before a piece to the key frame after it."""
    before, after = [key for key in keys if key < first], [key for key in keys if key > last]
    return range(before[-1] if before else first, (after[0] if after else last) + 1)


def _write_pictures(folder: Path, frames: Iterable[Frame], chosen: Sequence[int]) -> list[str]:
    from dvc.picture_files import write_png

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
        models = list(pycolmap.incremental_mapping(database, folder, target, _options(angle)).values())
        if sum(each.num_reg_images() for each in models) > sum(each.num_reg_images() for each in best):
            best = models
        if max((each.num_reg_images() for each in best), default=0) >= ENOUGH_SHARE * len(names):
            break
    return best


def _options(min_angle_deg: float) -> Any:
    import pycolmap

    pycolmap.set_random_seed(SEED)
    options = pycolmap.IncrementalPipelineOptions(
        num_threads=1, random_seed=SEED, min_model_size=MIN_KEYS, extract_colors=False
    )
    options.mapper.init_min_tri_angle = min_angle_deg
    options.mapper.filter_min_tri_angle = min(min_angle_deg, options.mapper.filter_min_tri_angle)
    options.triangulation.min_angle = min(min_angle_deg, options.triangulation.min_angle)
    return options


def model_poses(model: Any) -> dict[int, Floats]:
    """Return the poses of a model's pictures, which are named by their frame index."""
    return {
        int(Path(image.name).stem): np.asarray(image.cam_from_world().matrix(), np.float64)
        for image in model.images.values()
        if image.has_pose
    }


def _structure(model: Any, tracks: SequenceTracks, located: set[int]) -> Structure:
    """Return a structure with COLMAP's cameras, and points triangulated from the tracks."""
    camera = next(iter(model.cameras.values()))
    K = np.array(camera.calibration_matrix(), np.float64)
    K[:2, 2] -= COLMAP_FIRST_PIXEL_PX
    poses = {frame: pose for frame, pose in model_poses(model).items() if frame not in located}
    structure = Structure(K, dict(sorted(poses.items())), np.full((tracks.num_points, 3), np.nan))
    numbers, points = triangulate(structure, observations(tracks.seen, list(structure.poses)))
    structure.points[numbers] = points
    return structure
