"""Maps against the truth: `python -m benchmarks.mapping [CLIP ...] [--mapper M] [--colmap] [--json FILE]`.

Clips are rendered scenes by name, and folders with `color` and `pose` (4x4 matrices, camera to world).
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dvc.calibration.colmap import quiet
from dvc.config import SFM_BACKENDS
from dvc.metrics import psnr_db
from dvc.video import Frame, open_video
from sfm.mapping.colmap_mapper import model_poses, run_colmap
from sfm.mapping.rendering import render_view
from sfm.mapping.scene_map import MapPiece, SceneMap
from sfm.mapping.sequence import map_sequence
from sfm.mapping.trajectory import TrajectoryError, trajectory_error

Floats = NDArray[np.float64]
SCENES = ("street", "stairway", "statue")
DEPTH_UNIT_M = 1e-3
"""Of depth pictures."""
MAX_VIEWS = 8
"""Left-out frames that are rendered, spread over the clip."""
CLOSE = 0.05
"""Relative error of depth that counts as close."""


@dataclass(frozen=True, eq=False)
class Clip:
    """Frames and the truth about them, as far as it is known."""

    frames: list[Frame]
    poses: dict[int, Floats]  # camera from world
    depths: dict[int, NDArray[np.float32]]  # along the optical axis; not finite where it is not known


def rendered_clip(name: str) -> Clip:
    """Render a scene."""
    from sequences.sequence import RenderedSequence

    views = list(RenderedSequence(name).rendered())
    poses = {k: view.camera.cam_from_world for k, view in enumerate(views)}
    return Clip([view.frame for view in views], poses, {k: view.depth for k, view in enumerate(views)})


def real_clip(folder: Path) -> Clip:
    """Read a folder of pictures, poses and depth pictures."""
    import cv2

    frames = list(open_video(folder / "color"))
    paths = sorted((folder / "pose").glob("*.txt"))
    poses = {k: np.asarray(np.linalg.inv(np.loadtxt(path))[:3], np.float64) for k, path in enumerate(paths)}
    depths: dict[int, NDArray[np.float32]] = {}
    for path in sorted((folder / "depth").glob("*.png")):
        stored = np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), np.float32)
        depths[int(path.stem)] = np.asarray(np.where(stored > 0, DEPTH_UNIT_M * stored, np.inf), np.float32)
    return Clip(frames, poses, depths)


def depth_errors(piece: MapPiece, clip: Clip) -> dict[str, float]:
    """Compare depths with the truth, in one scale for all; what is not known counts as wrong."""
    frames = sorted(piece.depths.keys() & clip.depths.keys())
    if not frames:
        return {}
    ratios = []
    for frame in frames:
        true = clip.depths[frame]
        ratios.append((piece.depths[frame] / true)[np.isfinite(true)])
    ratio = np.concatenate(ratios)
    known = np.isfinite(ratio)
    errors = np.where(known, np.abs(ratio / np.median(ratio[known]) - 1.0), np.inf)
    return {
        "depth_frames": len(frames),
        "depth_median_error": float(np.median(errors)),
        "depth_share_close": float(np.mean(errors <= CLOSE)),
        "depth_share_known": float(np.mean(known)),
    }


def view_quality(piece: MapPiece, clip: Clip) -> dict[str, float]:
    """Render left-out frames from several frames with depth, and from the nearest alone; mean luma PSNR."""
    pictures = {k: clip.frames[k].luma[:, :, None] for k in piece.depths}
    first, last = min(piece.depths), max(piece.depths)
    free = [k for k in piece.poses if k not in piece.depths and first < k < last]
    chosen = (
        [free[k] for k in np.unique(np.linspace(0, len(free) - 1, MAX_VIEWS).round().astype(int))]
        if free
        else []
    )
    quality = [
        [
            psnr_db(clip.frames[k].luma, np.clip(np.rint(view.image[:, :, 0]), 0, 255).astype(np.uint8))
            for view in (render_view(piece, pictures, piece.poses[k], count) for count in (4, 1))
        ]
        for k in chosen
    ]
    if not quality:
        return {}
    several, alone = np.mean(quality, axis=0)
    return {"views": len(quality), "view_psnr_db": float(several), "nearest_psnr_db": float(alone)}


def colmap_error(clip: Clip) -> TrajectoryError | None:
    """Run COLMAP's incremental mapper on all frames, and judge its largest model."""
    import cv2

    with tempfile.TemporaryDirectory() as folder, quiet():
        names = [f"{k:08d}.png" for k in range(len(clip.frames))]
        for name, frame in zip(names, clip.frames, strict=True):
            cv2.imwrite(f"{folder}/{name}", frame.luma)
        models = run_colmap(Path(folder), names, "SIMPLE_RADIAL")
        poses = [model_poses(model) for model in models]
    largest = max(poses, key=len, default={})
    return trajectory_error(largest, clip.poses) if len(largest) > 2 else None


def measure(clip: Clip, mapper: str, with_colmap: bool) -> dict[str, Any]:
    """Measure all figures of one clip."""
    start = time.perf_counter(), time.process_time()
    found: SceneMap = map_sequence(lambda: clip.frames, mapper=mapper)
    row: dict[str, Any] = {
        "frames": len(clip.frames),
        "located": found.num_located,
        "pieces": len(found.pieces),
        "wall_s": time.perf_counter() - start[0],
        "cpu_s": time.process_time() - start[1],
    }
    piece = max(found.pieces, key=lambda each: len(each.poses), default=None)
    if piece is not None:
        row |= _error("", trajectory_error(piece.poses, clip.poses))
        row |= {"focal_px": float(piece.intrinsics[0, 0]), "points": len(piece.points)}
        row |= depth_errors(piece, clip) | view_quality(piece, clip)
    error = colmap_error(clip) if with_colmap else None
    return row | (_error("colmap_", error) if error is not None else {})


def _error(prefix: str, error: TrajectoryError) -> dict[str, float]:
    return {
        f"{prefix}rms_m": error.rms,
        f"{prefix}rms_percent": 100.0 * error.relative,
        f"{prefix}compared": error.num_located,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure clips and print a line for each figure."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mapping", description=__doc__)
    parser.add_argument("clips", nargs="*", metavar="CLIP", default=SCENES)
    parser.add_argument("--mapper", choices=SFM_BACKENDS, default=SFM_BACKENDS[0])
    parser.add_argument("--colmap", action="store_true", help="run COLMAP on all frames as well")
    parser.add_argument("--json", metavar="FILE", help="write the figures to a file")
    options = parser.parse_args(arguments)
    rows = {}
    for name in options.clips:
        clip = rendered_clip(name) if name in SCENES else real_clip(Path(name))
        rows[name] = measure(clip, options.mapper, options.colmap)
        print(name, *(f"{key}={value:.5g}" for key, value in rows[name].items()), flush=True)
    if options.json:
        Path(options.json).write_text(json.dumps(rows, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
