"""Mapping by COLMAP: its incremental mapper on key frames; all other frames follow from tracked points.

COLMAP puts the centre of the first pixel at (0.5, 0.5); this module converts.
"""

import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.geometry.camera_estimation import quiet
from dvc.geometry.cameras import COLMAP_FIRST_PIXEL_PX
from dvc.video import Frame
from sfm.mapping.adjustment import SEED
from sfm.mapping.reconstruction import MIN_KEYS, complete_by_tracks
from sfm.mapping.structure import Structure
from sfm.mapping.tracking import SequenceTracks

Floats = NDArray[np.float64]

MAX_FRAMES = 120
"""Frames that COLMAP gets at most."""
MAX_EXHAUSTIVE = 30
"""So many frames or fewer are all matched with each other; of more, only near ones."""
OVERLAP = 12
"""How many frames farther on each is matched with."""
INITIAL_ANGLES_DEG = (16.0, 4.0, 1.5)
"""Least angle between the rays of the first pair: COLMAP's own, then what slow cameras need."""


def colmap_pieces(
    frames: Callable[[], Iterable[Frame]], tracks: SequenceTracks, report: Callable[[str], None]
) -> list[Structure]:
    """Find the cameras of a sequence: structures that share no coordinate frame, in order."""
    chosen = _spaced(tracks.key_frames)
    if len(chosen) < MIN_KEYS:
        return []
    report(f"COLMAP: {len(chosen)} key frames")
    with tempfile.TemporaryDirectory() as folder, quiet():
        names = _write(Path(folder), frames(), chosen)
        models = run_colmap(Path(folder), names)
    pieces: list[Structure] = []
    taken: set[int] = set()
    for model in sorted(models, key=lambda each: -each.num_reg_images()):
        piece = _structure(model, tracks, taken)
        if len(piece.poses) >= MIN_KEYS:
            first, last = min(piece.poses), max(piece.poses)
            reached = _reach(tracks, first, last)
            completed = complete_by_tracks(piece, tracks, [k for k in reached if k not in taken])
            taken |= completed.poses.keys()
            pieces.append(completed)
    return sorted(pieces, key=lambda each: min(each.poses))


def _spaced(keys: Sequence[int]) -> list[int]:
    places = np.unique(np.linspace(0, len(keys) - 1, min(len(keys), MAX_FRAMES)).round().astype(int))
    return [keys[place] for place in places] if keys else []


def _reach(tracks: SequenceTracks, first: int, last: int) -> range:
    """Return the frames from the key frame before a piece to the one after it."""
    before = [key for key in tracks.key_frames if key < first]
    after = [key for key in tracks.key_frames if key > last]
    return range(before[-1] if before else first, (after[0] if after else last) + 1)


def _write(folder: Path, frames: Iterable[Frame], chosen: Sequence[int]) -> list[str]:
    from dvc.picture_files import write_png

    wanted = set(chosen)
    names = []
    for index, frame in enumerate(frames):
        if index in wanted:
            names.append(f"{index:08d}.png")
            write_png(folder / names[-1], frame.luma)
    return names


def run_colmap(folder: Path, names: Sequence[str], camera_model: str = "SIMPLE_PINHOLE") -> list[Any]:
    """Return COLMAP's models of the pictures in a folder, which one camera has taken."""
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
    models: list[Any] = []
    for attempt, angle in enumerate(INITIAL_ANGLES_DEG):
        target = folder / f"model{attempt}"
        target.mkdir()
        found = list(pycolmap.incremental_mapping(database, folder, target, _options(angle)).values())
        if sum(each.num_reg_images() for each in found) > sum(each.num_reg_images() for each in models):
            models = found
        if max((each.num_reg_images() for each in models), default=0) >= 0.9 * len(names):
            break
    return models


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
    """Return the poses of a model's pictures, which are named by their number."""
    return {
        int(Path(image.name).stem): np.asarray(image.cam_from_world().matrix(), np.float64)
        for image in model.images.values()
        if image.has_pose
    }


def _structure(model: Any, tracks: SequenceTracks, taken: set[int]) -> Structure:
    """Take over cameras; points are those of the tracks."""
    camera = next(iter(model.cameras.values()))
    K = np.array(camera.calibration_matrix(), np.float64)
    K[:2, 2] -= COLMAP_FIRST_PIXEL_PX
    poses = {frame: pose for frame, pose in model_poses(model).items() if frame not in taken}
    return Structure(K, dict(sorted(poses.items())), np.full((tracks.num_points, 3), np.nan))
