"""Surfaces of pairs of plain photographs against measured depth, compared with StereoSGBM.

``python -m benchmarks.plain_pairs [--pairs 10] [--json pairs.json]`` takes pairs of a folder with `color`,
`pose`, `depth` and `intrinsics.txt`, such as `../shared/sequences/kitchen`, as uncalibrated photographs:
`dvc-stereo rectify --cameras auto`, then `dvc-stereo reconstruct` of its output. Depth of the first
photograph is compared with the truth in one scale for each pair; unknown depth counts as wrong.

Pairs are chosen by the poses: for every photograph with depth, the second one with a distance nearest to a
tenth of the median depth, if the camera has moved more sideways than forwards and both see enough of the
scene; of these N, spread evenly. Surfaces were inspected only for pairs in even rows of the table, from 0;
the matching of points was chosen by every other possible pair, including two of the odd rows. Columns:
distance over depth; pixels of a rectified view over those of a photograph; rms of the rows of matches; share
of depths that are off by less than 5 %, of all and of those that both see, ours and that of StereoSGBM on
the same rectified pair, with its best settings on all these pairs; seconds of both commands, and of
processors.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.baselines.opencv_stereo import SemiGlobalSettings, semi_global_baseline
from benchmarks.mapping import CLOSE, DEPTH_UNIT_M
from benchmarks.results.harness import run_module
from benchmarks.searches.surfaces import GRID
from dvc.errors import DvcError
from dvc.picture_files import read_levels, read_pfm
from dvc.stereo.reconstruct_commands import RectifiedViews, read_rectified
from dvc.stereo.rectification.rectified_space import metric_depth, to_original_view

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

CLIP = Path("..") / "shared" / "sequences" / "kitchen"
COLOUR_K = np.array([[528.0, 0.0, 325.5], [0.0, 528.0, 241.3], [0.0, 0.0, 1.0]])
COLOUR_TURN, COLOUR_SHIFT_M = (0.006, -0.0108, 0.0013), (-0.0174, 0.0024, -0.0028)
"""Camera of the photographs relative to the depth camera: the pose with the smallest errors of warps."""
WANTED_RATIO, LEAST_RATIO, MOST_RATIO = 0.1, 0.05, 0.2
"""Ratio of the distance between both cameras to the median depth: target, lowest and highest."""
LEAST_OVERLAP, LEAST_SIDEWAYS = 0.7, 0.5**0.5
"""Share of the first photograph that the second shows; share of the motion that is across the axis."""
MOST_FRAMES = 60
"""Largest number of frames between the two."""
NUM_PAIRS = 10
HIDDEN = 0.05
"""Least difference in depth, as a share, between a point and one that hides it."""
JOBS = 2


class Pair(NamedTuple):
    """Two photographs of a clip."""

    first: int
    second: int
    ratio: float  # ratio of their distance to the median depth


class Clip:
    """A folder of photographs, depth and poses; all of the camera that took the photographs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._depth_K = np.loadtxt(folder / "intrinsics.txt")
        self.with_depth = sorted(int(path.stem) for path in (folder / "depth").glob("*.png"))
        self.frames = sorted(int(path.stem) for path in (folder / "pose").glob("*.txt"))
        self._beside = np.eye(4)
        self._beside[:3, :3] = Rotation.from_rotvec(COLOUR_TURN).as_matrix()
        self._beside[:3, 3] = COLOUR_SHIFT_M
        self._poses = {
            k: np.loadtxt(folder / "pose" / f"{k:06d}.txt") @ np.linalg.inv(self._beside) for k in self.frames
        }

    def photograph(self, frame: int) -> Path:
        """Return the file of a photograph."""
        return self.folder / "color" / f"{frame:06d}.jpg"

    def moved(self, pair: tuple[int, int]) -> Floats:
        """Return the motion between two cameras, second from first."""
        first, second = (self._poses[k] for k in pair)
        return np.asarray(np.linalg.inv(second) @ first)

    def depth(self, frame: int) -> Floats:
        """Return depth as the photograph sees it; infinite if unknown."""
        stored = read_levels(self.folder / "depth" / f"{frame:06d}.png")
        measured = np.where(stored > 0.0, DEPTH_UNIT_M * stored, np.inf)
        points = in_space(measured, self._depth_K) @ self._beside[:3, :3].T + self._beside[:3, 3]
        seen = np.full(measured.shape, np.inf)
        x, y, inside = pixels(points, seen.shape)
        np.minimum.at(seen, (y[inside], x[inside]), points[inside, 2])
        nearest = cv2.erode(seen, np.ones((3, 3)))
        return np.where(seen * (1.0 - HIDDEN) > nearest, np.inf, seen)


def in_space(depth: Floats, K: Floats) -> Floats:
    """Return the points with known depth."""
    y, x = np.nonzero(np.isfinite(depth))
    rays = np.column_stack([x, y, np.ones(len(x))]) @ np.linalg.inv(K).T
    return np.asarray(rays * depth[y, x][:, None])


def pixels(points: Floats, shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64], Mask]:
    """Return the pixels of a photograph that show points, and which of them are inside."""
    image = points @ COLOUR_K.T
    with np.errstate(divide="ignore", invalid="ignore"):
        place = np.clip(np.nan_to_num(image[:, :2] / image[:, 2:], nan=-1.0), -1.0, 1e6)
    x, y = np.rint(place).astype(np.int64).T
    inside = (points[:, 2] > 0.0) & (x >= 0) & (x < shape[1]) & (y >= 0) & (y < shape[0])
    return x, y, inside


def seen_by_both(clip: Clip, pair: Pair, depth: Floats) -> Mask:
    """Return a mask of the pixels of the first photograph that the second one shows unoccluded."""
    motion = clip.moved(pair[:2])
    points = in_space(depth, COLOUR_K) @ motion[:3, :3].T + motion[:3, 3]
    x, y, inside = pixels(points, depth.shape)
    nearest = np.full(depth.shape, np.inf)
    np.minimum.at(nearest, (y[inside], x[inside]), points[inside, 2])
    nearest = cv2.erode(nearest, np.ones((3, 3)))
    inside[inside] = points[inside, 2] * (1.0 - HIDDEN) <= nearest[y[inside], x[inside]]
    seen = np.isfinite(depth)
    seen[seen] = inside
    return seen


def possible_pairs(clip: Clip) -> list[Pair]:
    """Return the best second photograph, if any, for every photograph with depth."""
    found = []
    for first in clip.with_depth:
        depth = clip.depth(first)
        middle = float(np.median(depth[np.isfinite(depth)]))
        near = [k for k in clip.frames if 0 < abs(k - first) <= MOST_FRAMES]
        pairs = [Pair(first, k, float(np.linalg.norm(clip.moved((first, k))[:3, 3])) / middle) for k in near]
        pairs = [pair for pair in pairs if _is_sensible(clip, pair, depth[::8, ::8])]
        found += sorted(pairs, key=lambda pair: abs(np.log(pair.ratio / WANTED_RATIO)))[:1]
    return found


def _is_sensible(clip: Clip, pair: Pair, depth: Floats) -> bool:
    motion = clip.moved(pair[:2])
    centre = -motion[:3, :3].T @ motion[:3, 3]
    sideways = np.hypot(centre[0], centre[1]) / np.linalg.norm(centre)
    if not (LEAST_RATIO <= pair.ratio <= MOST_RATIO and sideways >= LEAST_SIDEWAYS):
        return False
    points = in_space(depth, np.diag([0.125, 0.125, 1.0]) @ COLOUR_K) @ motion[:3, :3].T + motion[:3, 3]
    return bool(pixels(points, (8 * depth.shape[0], 8 * depth.shape[1]))[2].mean() >= LEAST_OVERLAP)


def spread(pairs: Sequence[Pair], count: int) -> list[Pair]:
    """Return some pairs, evenly spread."""
    wanted = min(count, len(pairs))
    return [pairs[k * len(pairs) // wanted] for k in range(wanted)]


def close_percent(depth: Floats, truth: Floats, both: Mask) -> tuple[float, float]:
    """Return the share of right depths in one scale, of all and of those that both see, in per cent."""
    known = np.isfinite(truth)
    ratio = np.where(np.isfinite(depth) & (depth > 0.0), depth, np.nan)[known] / truth[known]
    right = np.abs(ratio / np.nanmedian(ratio) - 1.0) <= CLOSE
    return 100.0 * float(right.mean()), 100.0 * float(right[both[known]].mean())


def baseline_depth(rectified: RectifiedViews, settings: SemiGlobalSettings) -> Floats:
    """Return the depth of the first photograph by StereoSGBM on the rectified views."""
    array, labels = rectified.array, rectified.labels
    if labels is None:
        raise DvcError("too few points match to find the range of disparities")
    lowest = int(np.floor(labels.lowest))
    step = np.subtract(array[1].position, array[0].position)
    first, second = (np.ascontiguousarray(_to_the_left(view.image, step)) for view in array)
    moved = np.roll(second, lowest, axis=1)
    found = semi_global_baseline(first, moved, labels.highest - lowest, settings) + lowest
    disparity = _from_the_left(found.astype(np.float32), step)
    original = to_original_view(rectified.rectification, 0, np.ascontiguousarray(disparity))
    return metric_depth(rectified.rectification, 0, original).astype(np.float64)


def _to_the_left(image: NDArray[np.uint8], step: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Turn a picture of a pair as if the first camera were the left one."""
    turned = image.swapaxes(0, 1) if step[1] else image
    return turned[:, ::-1] if step.sum() < 0.0 else turned


def _from_the_left(plane: NDArray[np.float32], step: NDArray[np.float64]) -> NDArray[np.float32]:
    turned = plane[:, ::-1] if step.sum() < 0.0 else plane
    return turned.T if step[1] else turned


def measured(clip: Clip, pair: Pair) -> tuple[dict[str, Any], list[tuple[float, float]]]:
    """Run the commands on a pair; return their figures, and those of StereoSGBM with each of `GRID`."""
    truth = clip.depth(pair.first)
    both = seen_by_both(clip, pair, truth)
    with tempfile.TemporaryDirectory() as name:
        rectified, surfaces = (Path(name) / part for part in ("rectified", "surfaces"))
        photographs = [clip.photograph(k) for k in pair[:2]]
        used = [
            run_module("dvc.stereo", "rectify", *photographs, "--cameras", "auto", "--out", rectified),
            run_module("dvc.stereo", "reconstruct", rectified, "--out", surfaces, "--jobs", JOBS),
        ]
        depth = read_pfm(surfaces / f"depth-{photographs[0].stem}.pfm").astype(np.float64)
        views = read_rectified(rectified)
    theirs = [close_percent(baseline_depth(views, settings), truth, both) for settings in GRID]
    focal_length = views.rectification.cameras[0].focal_length_px
    return {
        "pair": pair[:2],
        "ratio": pair.ratio,
        "growth": float(np.prod(views.array.shape)) / truth.size,
        "row_rms_px": views.index["row_rms_px"],
        "focal_length_px": focal_length,
        "disparities": views.labels,
        "close_percent": close_percent(depth, truth, both),
        "wall_s": sum(one.wall_s for one in used),
        "cpu_s": sum(one.cpu_s for one in used),
    }, theirs


def line(row: dict[str, Any], theirs: tuple[float, float]) -> str:
    """Return a line of the table."""
    shares = " ".join(f"{a:6.1f} {b:6.1f}" for a, b in zip(row["close_percent"], theirs, strict=True))
    numbers = f"{row['ratio']:5.3f} {row['growth']:5.2f} {row['row_rms_px'] or np.nan:5.2f}"
    return (
        f"{row['pair'][0]:4} {row['pair'][1]:4} {numbers} {shares} {row['wall_s']:6.1f} {row['cpu_s']:6.1f}"
    )


def means(rows: Sequence[dict[str, Any]], theirs: Sequence[tuple[float, float]]) -> str:
    """Return the line of the means of some pairs."""
    shares = np.column_stack(
        [np.mean([row["close_percent"] for row in rows], axis=0), np.mean(theirs, axis=0)]
    )
    numbers = " ".join(f"{a:6.1f} {b:6.1f}" for a, b in shares)
    seconds = (np.mean([row[key] for row in rows]) for key in ("wall_s", "cpu_s"))
    return " ".join([numbers, *(f"{value:6.1f}" for value in seconds)])


def main(words: Sequence[str] | None = None) -> int:
    """Print a line for each pair, and the means of those at even and at odd places."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks.plain_pairs", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("clip", nargs="?", type=Path, default=CLIP, help=f"default: {CLIP}")
    parser.add_argument("--pairs", type=int, default=NUM_PAIRS, metavar="N", help="default: %(default)s")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures")
    arguments = parser.parse_args(words)
    if not (arguments.clip / "intrinsics.txt").is_file():
        parser.exit(2, f"{arguments.clip}: not a clip with poses, depth and intrinsics.txt\n")
    clip = Clip(arguments.clip)
    rows, theirs = [], []
    pairs = spread(possible_pairs(clip), arguments.pairs)
    if not pairs:
        parser.exit(2, f"{arguments.clip}: no two photographs have enough in common\n")
    for pair in pairs:
        row, found = measured(clip, pair)
        rows.append(row)
        theirs.append(found)
        print(line(row, max(found)), file=sys.stderr, flush=True)
    best = int(np.argmax(np.mean(theirs, axis=0)[:, 0]))
    baseline = [found[best] for found in theirs]
    heads = f"{'all':>6} {'SGBM':>6} {'both':>6} {'SGBM':>6} {'s':>6} {'cpu s':>6}"
    print(f"{GRID[best]}\n{'pair':>9} {'ratio':>5} {'size':>5} {'rows':>5} {heads}")
    for row, other in zip(rows, baseline, strict=True):
        print(line(row, other))
    for name, part in (("even", slice(0, None, 2)), ("odd", slice(1, None, 2)), ("all", slice(None))):
        if rows[part]:
            print(f"{name:27} {means(rows[part], baseline[part])}")
    if arguments.json is not None:
        figures = [row | {"baseline_close_percent": other} for row, other in zip(rows, baseline, strict=True)]
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
