"""Maps against the truth: `python -m benchmarks.mapping [CLIP ...] [--qp N] [--step N] [--colmap]`.

Clips are rendered scenes by name, and folders with `color`, `pose` (4x4 matrices, camera to world) and
`depth` (16 bit, millimetres), such as `../shared/sequences/kitchen`. With `--qp` maps are made of what the
default codec has decoded. Of the path the table has the error of camera centres, relative to its length; of
depth the median error and the share of pixels that are close; of views the PSNR of frames left out, rendered
from several frames and from the nearest one. COLMAP by itself, with `--colmap`, gets all frames and gives the
path: its time grows fast with their number, which `--step` bounds.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.map_evaluation import TrajectoryError, render_view, trajectory_error
from benchmarks.results.harness import SCENES, run_module
from dvc.config import MAPPERS
from dvc.geometry.camera_estimation import quiet
from dvc.metrics import psnr_db
from dvc.video import Frame, create_video, open_video
from sfm.mapping.map_sequence import map_sequence, model_poses, run_colmap
from sfm.mapping.scene_map import MapPiece, SceneMap

Floats = NDArray[np.float64]
DEPTH_UNIT_M = 1e-3
"""Unit of depth pictures."""
LEFT_OUT = 8
"""Interval of frames that are rendered from the remaining ones."""
CLOSE = 0.05
"""Relative error of depth that counts as close."""
COLMAP_ONLY = "COLMAP only"
"""COLMAP's mapper without this project's key frames, tracks and depth."""
JOBS = 2
"""Processes that decode."""
FRAME_RATE = 30
"""Frame rate of coded clips; no figure depends on it."""
COLUMNS = {
    "located": ("located", ".0f", 1.0),
    "pieces": ("pieces", ".0f", 1.0),
    "path %": ("rms_percent", ".3f", 1.0),
    "depth %": ("depth_median_error", ".2f", 100.0),
    "close %": ("depth_share_close", ".1f", 100.0),
    "views dB": ("view_psnr_db", ".2f", 1.0),
    "nearest dB": ("nearest_psnr_db", ".2f", 1.0),
    "time s": ("wall_s", ".0f", 1.0),
}
"""Headings of the table, and their figures with format and unit."""


@dataclass(frozen=True, eq=False)
class Clip:
    """Frames and their known truth."""

    frames: list[Frame]
    poses: dict[int, Floats]  # camera from world
    depths: dict[int, NDArray[np.float32]]  # along the optical axis; not finite if unknown
    depth_intrinsics: Floats | None = None  # intrinsics of the depth camera, if it is another one


def rendered_clip(name: str) -> Clip:
    """Render a scene."""
    from sequences.rendered_sequence import RenderedSequence

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
    return Clip(frames, poses, depths, np.loadtxt(folder / "intrinsics.txt"))


def every(clip: Clip, step: int) -> Clip:
    """Return every N-th frame of a clip."""
    poses = {k // step: pose for k, pose in clip.poses.items() if k % step == 0}
    depths = {k // step: depth for k, depth in clip.depths.items() if k % step == 0}
    return replace(clip, frames=clip.frames[::step], poses=poses, depths=depths)


def decoded(frames: Sequence[Frame], qp: int) -> list[Frame]:
    """Encode and decode frames with the default codec, as processes."""
    with tempfile.TemporaryDirectory() as folder:
        original, stream, made = (
            Path(folder) / name for name in ("original.y4m", "coded.dvc", "decoded.y4m")
        )
        with create_video(original, (frames[0].width, frames[0].height), Fraction(FRAME_RATE)) as writer:
            for frame in frames:
                writer.write(frame)
        run_module("encoder", original, stream, "--qp", qp, "--quiet")
        run_module("decoder", stream, made, "--jobs", JOBS, "--quiet")
        with open_video(made) as reader:
            return list(reader)


def true_depth(clip: Clip, frame: int, K: Floats) -> NDArray[np.float32]:
    """Return depth as a camera sees it, except for its distance from the depth camera."""
    import cv2

    depth = clip.depths[frame]
    if clip.depth_intrinsics is None:
        return depth
    size, turned = depth.shape[::-1], K @ np.linalg.inv(clip.depth_intrinsics)
    flags, border = cv2.INTER_NEAREST, cv2.BORDER_CONSTANT
    seen = cv2.warpPerspective(depth, turned, size, flags=flags, borderMode=border, borderValue=np.inf)
    return np.asarray(seen, np.float32)


def depth_errors(piece: MapPiece, clip: Clip) -> dict[str, float]:
    """Compare depths with the truth, in one scale for all; unknown depth counts as wrong."""
    frames = sorted(piece.depths.keys() & clip.depths.keys())
    if not frames:
        return {}
    ratios = []
    for frame in frames:
        true = true_depth(clip, frame, piece.intrinsics)
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


def view_quality(piece: MapPiece, clip: Clip, seen: Sequence[Frame]) -> dict[str, float]:
    """Render left-out frames from several frames with depth, and from the nearest; return mean luma PSNRs."""
    pictures = {k: seen[k].luma[:, :, None] for k in piece.depths}
    quality = []
    for k in sorted(piece.poses):
        rest = replace(piece, depths={key: depth for key, depth in piece.depths.items() if key != k})
        if k % LEFT_OUT or not rest.depths or not min(rest.depths) < k < max(rest.depths):
            continue
        views = [render_view(rest, pictures, piece.poses[k], count).image[:, :, 0] for count in (4, 1)]
        levels = [np.clip(np.rint(view), 0, 255).astype(np.uint8) for view in views]
        quality.append([psnr_db(clip.frames[k].luma, each) for each in levels])
    if not quality:
        return {}
    several, nearest = np.mean(quality, axis=0)
    return {"views": len(quality), "view_psnr_db": float(several), "nearest_psnr_db": float(nearest)}


def colmap_alone(clip: Clip, seen: Sequence[Frame]) -> dict[str, Any]:
    """Run COLMAP's incremental mapper on all frames, and judge its largest model."""
    import cv2

    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, quiet():
        names = [f"{k:08d}.png" for k in range(len(seen))]
        for name, frame in zip(names, seen, strict=True):
            cv2.imwrite(f"{folder}/{name}", frame.luma)
        models = run_colmap(Path(folder), names, "SIMPLE_RADIAL")
        poses = [model_poses(model) for model in models]
    largest = max(poses, key=len, default={})
    figures = {
        "located": len({k for each in poses for k in each}),
        "pieces": len(poses),
        "wall_s": time.perf_counter() - start,
    }
    return figures | (_path_error(trajectory_error(largest, clip.poses)) if len(largest) > 2 else {})


def measure(clip: Clip, seen: list[Frame], mapper: str) -> dict[str, Any]:
    """Map frames as they are seen; return all figures, by the truth about them."""
    start = time.perf_counter(), time.process_time()
    found: SceneMap = map_sequence(lambda: seen, mapper=mapper)
    row: dict[str, Any] = {
        "located": found.num_located,
        "pieces": len(found.pieces),
        "wall_s": time.perf_counter() - start[0],
        "cpu_s": time.process_time() - start[1],
    }
    piece = max(found.pieces, key=lambda each: len(each.poses), default=None)
    if piece is not None:
        row |= _path_error(trajectory_error(piece.poses, clip.poses))
        row |= {"focal_px": float(piece.intrinsics[0, 0]), "points": len(piece.points)}
        row |= depth_errors(piece, clip) | view_quality(piece, clip, seen)
    return row


def _path_error(error: TrajectoryError) -> dict[str, float]:
    return {"rms_m": error.rms, "rms_percent": 100.0 * error.relative, "compared": error.num_located}


def measured(name: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Measure one clip, by each mapper that is wanted; print the rows of the table."""
    clip = every(rendered_clip(name) if name in SCENES else real_clip(Path(name)), options.step)
    seen = clip.frames if options.qp is None else decoded(clip.frames, options.qp)
    frames = f"{len(seen)} " + ("original" if options.qp is None else f"QP {options.qp}")
    rows = []
    for mapper in (options.mapper, *([COLMAP_ONLY] if options.colmap else [])):
        figures = colmap_alone(clip, seen) if mapper == COLMAP_ONLY else measure(clip, seen, mapper)
        rows.append({"clip": Path(name).name, "frames": frames, "mapper": mapper} | figures)
        print(line(rows[-1]), flush=True)
    return rows


def line(row: Mapping[str, Any]) -> str:
    """Return a line of the table; with a dash for a missing figure."""
    words = [f"{row['clip']:10} {row['frames']:14} {row['mapper']:14}"]
    for heading, (key, form, unit) in COLUMNS.items():
        text = f"{unit * row[key]:{form}}" if key in row else "-"
        words.append(f"{text:>{len(heading)}}")
    return "  ".join(words)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure clips and print a line for each mapper."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mapping", description=__doc__)
    parser.add_argument("clips", nargs="*", metavar="CLIP", default=SCENES)
    parser.add_argument("--qp", type=int, metavar="N", help="map what the default codec has decoded")
    parser.add_argument("--step", type=int, default=1, metavar="N", help="take only every N-th frame")
    parser.add_argument("--mapper", choices=MAPPERS, default=MAPPERS[0])
    parser.add_argument("--colmap", action="store_true", help="run COLMAP on all frames as well")
    parser.add_argument("--json", metavar="FILE", help="write all figures to a file")
    options = parser.parse_args(arguments)
    print("  ".join([f"{'clip':10} {'frames':14} {'mapper':14}", *COLUMNS]))
    rows = [row for name in options.clips for row in measured(name, options)]
    if options.json:
        Path(options.json).write_text(json.dumps(rows, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
